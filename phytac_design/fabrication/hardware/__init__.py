"""What holds a sensor together: camera mount, cover, connector, light bar, frames, screws."""
