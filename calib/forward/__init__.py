"""The forward problem of a study's fits: the model against the measured data that are not held out."""

from calib.forward.door import tested_for
from calib.forward.tested import AnyPair, ForwardProblem, Tested
from calib.forward.unseen import Unseen, UnseenFRFs, unseen_frfs, unseen_responses

__all__ = [
    "AnyPair",
    "ForwardProblem",
    "Tested",
    "Unseen",
    "UnseenFRFs",
    "tested_for",
    "unseen_frfs",
    "unseen_responses",
]
