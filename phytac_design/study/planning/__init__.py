"""What a scene requires: the stages, their resolution, their reasons and their cost."""
