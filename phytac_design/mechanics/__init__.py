"""Mechanics: meshes, shell element, solve, loads, compliance, and meshes for other solvers."""
