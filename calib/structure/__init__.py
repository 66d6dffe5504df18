"""Structural models: affine matrices over named parameters, geometry, eigenproblem, derivatives, reduction.

Models and libraries of effects import what they need from here and from `calib`; the modules below may move.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
