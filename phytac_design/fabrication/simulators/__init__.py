"""A sensor as a part of a robot simulator: masses, collision pieces, frames, and their files."""
