"""Calibration workbench for structural-dynamics models.

Public names are imported on first use: ``calib --version`` needs none.
"""

import lazy_loader as lazy

from calib.results.version import __version__ as __version__

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
