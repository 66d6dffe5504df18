"""A model against measured modes."""
