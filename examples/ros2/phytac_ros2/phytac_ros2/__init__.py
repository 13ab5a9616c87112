"""Nothing to import: the sensor publishes by `phytac serve --ros2`."""
