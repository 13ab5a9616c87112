"""What it takes to make a sensor, before anything is made."""
