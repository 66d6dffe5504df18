"""Reduced bases with a certified error."""
