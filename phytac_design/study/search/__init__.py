"""Search of the design space: studies, fidelity levels, driver and their results."""
