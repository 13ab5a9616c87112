"""Samples over processes, kept in a journal, gathered into a data set."""
