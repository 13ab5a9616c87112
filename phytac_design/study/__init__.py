"""Studies of a design: what a setting costs and gains, where it ends, what a scene needs."""
