"""Solid meshes of the true CAD, for other solvers and as a referee of the shell."""
