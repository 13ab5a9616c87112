"""The extremes of every room: each case right, refused in words, or wrong."""
