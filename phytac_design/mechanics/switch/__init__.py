"""Threshold switches: axisymmetric hyperelastic solids that snap, and their inverse design."""
