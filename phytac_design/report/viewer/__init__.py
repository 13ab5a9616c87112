"""The turnable 3-D shell and the hovered map: what they show, and the scripts that show it."""
