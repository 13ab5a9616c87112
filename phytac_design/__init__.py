"""The design tool: from one design file to shell, proof of visibility, mesh and decoder."""

__version__ = "0.1.0"
