"""Every evaluation and the history of every search, in one SQLite file."""

from calib.ledger.history import Asked
from calib.ledger.ledger import Ledger

__all__ = ["Asked", "Ledger"]
