"""Every evaluation and the history of every search, in one SQLite file."""

from calib.execution.outcome import Individual
from calib.results.ledger.ledger import Ledger

__all__ = ["Individual", "Ledger"]
