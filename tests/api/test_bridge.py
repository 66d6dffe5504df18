"""Shapes that are claimed too accurate drag the parameters of a complete model far from what its frequencies say.

The data are those of another beam with another discretisation, with noise and repeats.
"""

import pytest

import calib
from tests.api import mounted_beam as beam

pytestmark = pytest.mark.slow


def explained(folder, **errors):
    problem = calib.Problem(beam.model(), calib.ModalTest(beam.tested(folder, 1, **errors)))
    return problem.calibrate(starts=1, progress=False).explain(beam.library(), progress=False)


def test_the_accuracy_that_lets_the_model_fit_is_told_with_what_it_reaches(tmp_path):
    why = explained(tmp_path / "bridge", along=0.4, noise=0.004)
    assert why.verdict == "none_explains"
    table = why.explanation.tables["accuracy_by_kind"]
    assert table.loc[table["shape"] <= 0.05, "missing"].all() and not table.loc[table["shape"] >= 0.1, "missing"].any()
    (fact,) = [words for words in why.sentences if "10 % for shapes" in words]
    before, after = (
        float(part.split(" %")[0].split()[-1]) for part in (fact.split("instead of")[1], fact.split("would be ")[-1])
    )
    assert after < 1.0 < before
    assert "Only if your test has it" in why.explanation.answer.then and 'shape = "10 %"' in why.explanation.answer.then


def test_the_accuracy_comes_first_where_no_place_is_told(tmp_path):
    why = explained(tmp_path / "bridge", scatter=0.1, noise=0.004)
    assert why.explanation.explanation.place is None
    assert why.explanation.answer.then.startswith("Only if your test has it")
