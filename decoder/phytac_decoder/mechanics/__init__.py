"""Tabulated mechanics of a sensor, as a bundle holds them."""
