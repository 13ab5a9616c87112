"""Hardware of a sensor: camera mount, cover, connector, light bar, frames, screws."""
