"""How far a decoder's forces are from the truth."""
