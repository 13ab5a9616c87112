"""Fitting modulus, wall and Poisson ratio to measurements (paper, eq. 4)."""
