"""Modes that finite-element codes have computed, and their matrices, from their own files."""
