"""The decoder that runs beside the sensor: camera frames in, newtons out."""
