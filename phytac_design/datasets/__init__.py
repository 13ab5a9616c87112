"""Data sets on disk: samples of a sensor, simulated or measured."""
