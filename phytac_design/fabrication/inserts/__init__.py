"""Coloured inserts of the markers, on sprues that are printed apart from the shell."""
