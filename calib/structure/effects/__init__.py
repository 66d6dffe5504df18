"""Matrices of effects, attachments and local perturbations."""
