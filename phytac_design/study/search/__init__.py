"""Search of the design space: studies, their ladder of checks, their driver and their results."""
