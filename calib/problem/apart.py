"""A joint problem in which some parameters have a value of their own in some tests."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from calib.problem.joint import JointProblem, of_test
from calib.problem.space import ParameterSpace


class ApartProblem:
    """A joint problem whose space has a difference from the shared value for some parameters and tests.

    Parameters
    ----------
    joint : JointProblem
    chosen : sequence of (parameter, test)
    widths : mapping from parameter to float, optional
        Prior standard deviation of its differences around 0; by default that of the parameter.
    """

    def __init__(
        self, joint: JointProblem, chosen: Sequence[tuple[str, str]], widths: Mapping[str, float] | None = None
    ):
        self.joint, self.own = joint, {of_test(test, name): (name, test) for name, test in chosen}
        more = []
        for label, (name, _) in self.own.items():
            p = joint.space[name]
            reach, width = p.upper - p.lower, (widths or {}).get(name, p.prior_width)
            own = replace(p, scale="linear", prior=None, prior_sd=width, prior_correlation=())
            more.append(replace(own, name=label, value=0.0, lower=-reach, upper=reach))
        self.space = ParameterSpace((*joint.space.parameters, *more), joint.space.constraints)

    def _values(self, test: str, values: Mapping[str, float]) -> dict[str, float]:
        """Values of one test, its differences added, within the limits of the parameters."""
        own = self.joint.own(test, {name: value for name, value in values.items() if name not in self.own})
        for label, (name, where) in self.own.items():
            if where == test:
                p = self.joint.space[name]
                own[name] = min(max(own[name] + values[label], p.lower), p.upper)
        return own

    def residual(self, values: Mapping[str, float]) -> np.ndarray:
        """Whitened residual of all tests, (n_rows,)."""
        complete = self.space.complete(values)
        parts = self.joint.parts.items()
        return np.concatenate([problem.residual(self._values(test, complete)) for test, problem in parts])

    def jacobian(self, values: Mapping[str, float], names: Sequence[str]) -> np.ndarray:
        """Its derivative per unit of each parameter and each difference, (n_rows, n_params)."""
        complete, blocks = self.space.complete(values), []
        for test, problem in self.joint.parts.items():
            reached = [self.own[n][0] if n in self.own else n for n in names]
            acts = [(n not in self.own or self.own[n][1] == test) for n in names]
            needed = [n for n, act in zip(reached, acts, strict=True) if act and n in problem.space]
            own = list(dict.fromkeys(needed))
            slope = problem.jacobian(self._values(test, complete), own)
            block = np.zeros((len(slope), len(names)))
            for k, (n, act) in enumerate(zip(reached, acts, strict=True)):
                if act and n in own:
                    block[:, k] = slope[:, own.index(n)]
            blocks.append(block)
        return np.vstack(blocks)
