"""Printable shells: profile and receptors (numpy), meshes (manifold3d), STEP (CadQuery), export."""
