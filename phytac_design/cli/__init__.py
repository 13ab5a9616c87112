"""The command ``phytac``: one module per command."""
