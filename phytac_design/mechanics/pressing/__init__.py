"""One press on a sensor, from a user's words to what moves."""
