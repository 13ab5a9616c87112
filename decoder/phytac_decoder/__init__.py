"""The decoder that runs beside the sensor: camera frames in, forces in newtons out."""
