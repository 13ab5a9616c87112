"""What a scene requires: what is modelled, how finely, why, and at what cost."""
