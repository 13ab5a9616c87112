"""Quadrilateral meshes of the wall's middle face on every shape, and places on them."""
