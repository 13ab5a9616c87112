"""Camera model: lens, distortion and pose."""
