"""Evaluation of decoders: errors of their forces."""
