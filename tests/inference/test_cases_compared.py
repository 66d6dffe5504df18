"""Tables over several cases, and whether they agree on one solution."""

import numpy as np
import pandas as pd

from calib.inference.agreement import agreement
from calib.inference.cases import CaseResult, convergence_table, parameters_table


def result(name, misfit=0.1, **values):
    table = pd.DataFrame({"generation": [1, 2], "best": [1.0, misfit], "mean": [2.0, 1.0], "feasible": [3, 4]})
    return CaseResult(
        name, {"k": 2.0, "m": 0.5, "place": 2.0, "g": 9.81} | values, misfit, {}, table, 2, 2, 0, 0, 0, 1.0
    )


def test_the_parameters_table(search):
    table = parameters_table(
        [result("A", k=1.0, m=0.5), result("B", k=1.3, m=0.995), result("C", k=1.31, m=0.5)], search.space
    )
    assert table.columns.tolist() == [
        "case", "parameter", "value", "unit", "lower", "upper", "scale", "ratio", "on_limit", "spread", "stable"
    ]  # fmt: skip
    assert table["case"].tolist() == ["A"] * 3 + ["B"] * 3 + ["C"] * 3
    assert table["parameter"].tolist() == ["k", "m", "place"] * 3
    k = table[table.parameter == "k"]
    np.testing.assert_allclose(k["ratio"], [0.0, 0.1, 0.31 / 3], atol=1e-12)
    assert k["on_limit"].tolist() == [True, False, False] and k["unit"].tolist() == ["kN/m"] * 3
    np.testing.assert_allclose(k["spread"], 0.31 / 3)
    assert k["stable"].tolist() == [False] * 3
    m = table[table.parameter == "m"]
    assert m["on_limit"].tolist() == [False, True, False] and m["stable"].tolist() == [False] * 3
    assert table[table.parameter == "place"]["stable"].tolist() == [True] * 3


def test_the_threshold_of_stability(search):
    for value, stable in ((1.29, True), (1.31, False)):
        table = parameters_table([result("A", k=1.0), result("B", k=value)], search.space)
        assert table["stable"].iloc[0] is stable or table["stable"].iloc[0] == stable


def test_one_case_says_nothing_about_stability(tmp_path, search):
    table = parameters_table([result("A")], search.space)
    assert table["spread"].isna().all() and table["stable"].isna().all()
    table.to_csv(tmp_path / "parameters.csv", index=False)
    assert ",," in (tmp_path / "parameters.csv").read_text() or (tmp_path / "parameters.csv").read_text().endswith(
        ",\n"
    )


def test_the_convergence_table():
    table = convergence_table([result("A"), result("B", 0.2)])
    assert table.columns.tolist() == ["case", "generation", "best", "mean", "feasible"]
    assert table["case"].tolist() == ["A", "A", "B", "B"] and table["best"].tolist() == [1.0, 0.1, 1.0, 0.2]
    assert convergence_table([]).columns.tolist() == table.columns.tolist()


def test_cases_that_agree(search):
    found = agreement([result("A", 0.101), result("B", 0.100, k=2.19), result("C", 0.102)], search.space)
    assert found.verdict == "one solution" and found.solutions == (("B", "A", "C"),)
    assert not found.differing and found.worse == () and "6.3 %" in found.sentence


def test_several_solutions(search):
    cases = [result("A", 0.100), result("B", 0.103, k=3.5, m=0.7), result("C", 0.101, k=2.1), result("D", 0.5, m=0.0)]
    found = agreement(cases, search.space)
    assert found.verdict == "several solutions" and found.solutions == (("A", "C"), ("B",))
    assert list(found.differing) == ["k", "m"] and found.worse == ("D",)
    for words in ("not unique", "2 sets", "A, C", "k by 50 %", "m by 20 %", "D (misfit 0.5)"):
        assert words in found.sentence


def test_measurement_uncertainty_decides_what_fits_equally_well(search):
    cases = [result("A", 0.10), result("B", 0.19, k=3.5)]
    assert agreement(cases, search.space).verdict == "not settled"
    assert agreement(cases, search.space, level=0.18).verdict == "not settled"
    assert agreement(cases, search.space, level=0.20).verdict == "several solutions"
    assert agreement([result("A", 0.10), result("B", 0.19)], search.space, level=0.20).verdict == "one solution"


def test_one_case_and_unsettled_cases(search):
    assert agreement([result("A")], search.space).verdict == "one case"
    found = agreement([result("A", 0.1), result("B", 0.3), result("C", 0.2)], search.space)
    assert found.verdict == "not settled" and found.worse == ("C", "B") and "more generations" in found.remedy


def test_the_thresholds_of_equal_fits_and_of_different_solutions(search):
    for misfit, verdict in ((0.1049, "several solutions"), (0.1051, "not settled")):
        assert agreement([result("A", 0.1), result("B", misfit, k=3.5)], search.space).verdict == verdict
    for k, verdict in ((2.19, "one solution"), (2.21, "several solutions")):
        found = agreement([result("A"), result("B", k=k)], search.space)
        assert found.verdict == verdict and bool(found.differing) == (verdict == "several solutions")
        wider = agreement([result("A"), result("B", k=k)], search.space.widen({"k": (0.1, 40.0)}))
        assert wider.verdict == verdict  # solutions differ by what is needed, however far the limits reach
