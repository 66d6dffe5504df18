"""Modes and their derivatives."""
