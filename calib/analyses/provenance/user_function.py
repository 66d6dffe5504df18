"""Numbers of a user's function in a ledger.

For a function of scalar responses the numbers are these, for a function of modes all frequencies, damping ratios and
shapes. Both kinds therefore run in a child process and are stored in a ledger in the same way; what is compared with a
measurement is computed from the numbers.
"""

from __future__ import annotations

from dataclasses import replace

from calib.execution.outcome import Outcome, attempt
from calib.experiment.test import ForwardProblem
from calib.results.fingerprint import digest_of


def with_library(fingerprint: str, library: str) -> str:
    """Fingerprint of numbers that also depend on parameters of a library's effects."""
    return digest_of(fingerprint, library)[:16]


def ledger_keys_of_modes(problem: ForwardProblem, library: str) -> tuple[str, ...]:
    """All fingerprints of the numbers of a function of modes; empty for any other problem."""
    if problem.numbers_function is None:
        return ()
    own = problem.ledger_key
    return own, with_library(own, library)


def outcome_of(problem: ForwardProblem, numbers: Outcome) -> Outcome:
    """Outcome of a problem from that of its function: its responses, or the failure."""
    if problem.numbers_function is None or numbers.status == "failed":
        return numbers
    found = attempt(problem.with_function(lambda values: numbers.responses).evaluate, numbers.values)
    return replace(found, seconds=numbers.seconds)
