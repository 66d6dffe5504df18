"""A model against measured FRFs."""
