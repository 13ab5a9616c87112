"""Verification: every subsystem at its extremes, each case right, rejected or failing."""
