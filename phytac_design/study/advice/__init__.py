"""Advice: what to change about one design, each piece tried before it is given."""
