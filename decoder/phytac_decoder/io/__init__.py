"""Bundles, recordings, cameras and motion sensors."""
