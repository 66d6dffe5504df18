"""A test with any effect in its model."""
