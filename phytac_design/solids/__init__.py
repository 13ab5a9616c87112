"""CAD and print meshes of the shell, and STEP reading."""
