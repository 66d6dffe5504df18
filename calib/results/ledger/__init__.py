"""Every evaluation and the history of every search, in one SQLite file."""

from calib.execution.outcome import Asked
from calib.results.ledger.ledger import Ledger

__all__ = ["Asked", "Ledger"]
