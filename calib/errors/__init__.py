"""Errors, and the place in the user's own text that they name."""
