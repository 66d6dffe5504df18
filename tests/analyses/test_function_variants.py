"""A function whose results are cached: each point is called once, and what it raised is raised again."""

import traceback

import pytest

from calib.hypotheses.function_variants import Kept


def test_a_point_is_called_once_and_its_result_cannot_be_changed():
    asked = []
    cached = Kept(lambda values: asked.append(dict(values)) or {"y": [values["a"]]})
    cached({"a": 1.0, "b": 2.0})["y"].append(3.0)
    assert cached({"b": 2.0, "a": 1.0}) == {"y": [1.0]} and cached.calls == len(asked) == 1


def test_an_exception_is_raised_again_with_the_traceback_of_its_first_call():
    def fails(values):
        raise ValueError("no")

    cached, depths = Kept(fails), []
    for _ in range(4):
        with pytest.raises(ValueError, match="no") as caught:
            cached({"a": 1.0})
        frames = traceback.extract_tb(caught.value.__traceback__)
        depths.append(len(frames))
        assert frames[-1].name == "fails"
    assert len(set(depths[1:])) == 1 and cached.calls == 1
