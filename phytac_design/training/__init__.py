"""Decoders learnt from data sets."""
