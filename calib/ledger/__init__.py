"""Every evaluation and the history of every search, in one SQLite file."""

from calib.ledger.ledger import Ledger
from calib.outcome import Asked

__all__ = ["Asked", "Ledger"]
