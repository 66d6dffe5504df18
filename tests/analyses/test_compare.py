"""Sentences and tables of a comparison."""

from dataclasses import replace

import pandas as pd
import pytest

from calib.analyses.compare import comparison_at, write_comparison
from calib.results.results import Results
from calib.study.study import LoadedStudy


@pytest.mark.medium
def test_modes_paired_by_the_user_are_reported(here, mast, edited):
    def said(folder):
        study = LoadedStudy.load(folder)
        return [s for s in comparison_at(study, study.search_space.values).sentences if "Paired as the study says" in s]

    folder = mast.write_study(here / "mast")
    assert not said(folder)
    chosen = edited(folder, "[pairing]\n", "[pairing]\noverride = { B2x = 4 }\n")
    assert said(chosen) == ["Paired as the study says and not as computed: B2x with model mode 4."]


@pytest.mark.medium
def test_the_orthogonality_is_written_and_told(here, mast, tmp_path):
    study = LoadedStudy.load(mast.write_study(here / "mast"))
    answer = comparison_at(study, study.search_space.values)
    results = Results.at(tmp_path / "results", "mast")
    write_comparison(results, answer, "before")
    tables = {path.stem: pd.read_csv(path) for path in results.path.glob("*_before.csv")}
    checked, expanded = answer.orthogonality, answer.expanded
    cross, own = tables["cross_orthogonality_before"], tables["self_orthogonality_before"]
    assert cross.drop(columns=["mode", "model_mode"]).to_numpy() == pytest.approx(checked.cross, rel=1e-9, abs=1e-12)
    assert own.drop(columns="mode").to_numpy() == pytest.approx(checked.own, rel=1e-9, abs=1e-12)
    assert tables["expansion_before"]["residual"].to_numpy() == pytest.approx(expanded.residual)
    assert set(tables["expanded_shapes_before"]["mode"]) == set(cross["mode"])
    assert [s for s in answer.sentences if s == checked.sentence] and answer.sentences[-1].startswith("Where it fails")


@pytest.mark.medium
def test_shapes_that_cannot_be_expanded_have_a_reason_and_leave_no_tables(here, mast, tmp_path):
    """Two sensors at the same place and direction, of three modes: neither expansion exists."""
    study = LoadedStudy.load(mast.write_study(here / "mast"))
    results = Results.at(tmp_path / "results", "mast")
    write_comparison(results, comparison_at(study, study.search_space.values), "before")
    problem = study.problem
    measured = problem.measured
    few = replace(
        measured,
        sensors=(measured.sensors[0], replace(measured.sensors[0], node=99)),
        shapes=measured.shapes[[0, 0]],
        shape_std=measured.shape_std[[0, 0]],
        shape_count=None if measured.shape_count is None else measured.shape_count[[0, 0]],
    )
    pairs = {name: k + 1 for k, name in enumerate(measured.names)}
    poor = replace(study, problem=replace(problem, measured=few, override=pairs))
    answer = comparison_at(poor, study.search_space.values)
    assert answer.orthogonality is None and answer.expanded is None
    assert [s for s in answer.sentences if s.startswith("Mass-orthogonality is not known: ") and "2 sensors" in s]
    write_comparison(results, answer, "before")
    assert not list(results.path.glob("*ortho*")) and not list(results.path.glob("expan*"))
