"""Live operation: the sensor loop, force streams, the live view."""
