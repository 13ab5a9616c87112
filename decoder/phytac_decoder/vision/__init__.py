"""From a frame to marker positions and switch states."""
