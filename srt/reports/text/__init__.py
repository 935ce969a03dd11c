"""Tables and sentences of results as plain text."""
