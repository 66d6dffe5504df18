"""Measured modes and scalar responses with their repeats, read from UFF/UNV or CSV, averaged and checked."""
