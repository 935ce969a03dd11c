"""Results for people: text, figures, certificates."""
