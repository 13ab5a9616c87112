"""Published shell problems and closed forms that the solver is judged by."""
