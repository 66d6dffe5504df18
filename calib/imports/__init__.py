"""Modes that finite-element codes have computed, from their own files."""
