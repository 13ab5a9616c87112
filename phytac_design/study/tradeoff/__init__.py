"""The trade of speed for accuracy: every setting measured, and settings chosen by their error."""
