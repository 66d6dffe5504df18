"""A model against scalar responses."""
