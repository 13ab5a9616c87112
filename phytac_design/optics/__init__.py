"""What the camera sees: scene, exact ID map, visibility of every marker, pictures and frames."""
