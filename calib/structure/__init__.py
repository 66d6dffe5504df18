"""Structural models: affine matrices over named parameters, geometry, eigenproblem, derivatives, reduction."""
