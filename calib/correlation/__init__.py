"""Correlation of model and measurement: MAC, CoMAC, pairing, residuals and comparison tables."""
