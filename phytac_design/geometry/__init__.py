"""Triangle meshes, boundary loops, ray queries and overlaps."""
