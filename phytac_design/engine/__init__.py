"""Stages, their cache and its eviction."""
