"""The design file as pure schema: one module per table, presets, scenes, the catalogue."""
