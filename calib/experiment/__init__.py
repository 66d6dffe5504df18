"""The forward problem of a study's fits: the model against the measured data that are not held out."""

from calib.experiment.held_out import Unseen, UnseenFRFs, unseen_frfs, unseen_responses
from calib.experiment.tested import AnyPair, ForwardProblem, Tested
from calib.study.door import tested_for

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
