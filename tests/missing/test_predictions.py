"""Predictions of held-out data with and without an unexplained misfit, against closed forms and known truths."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import scipy.linalg as la
from scipy.stats import chi2

from calib.correlation.modal.rows import ModalRow
from calib.missing.discrepancy import discrepancy
from calib.missing.linearised_fit import LinearisedFit
from calib.missing.predictions import ERROR_COLUMNS, HeldOut, prediction_tables, predictions_sentence
from calib.missing.score import scored

P, N, M, HELD = 3, 60, 25, 20


def world(seed, size):
    """A linear model of three parameters with small changes by all candidates: its fit, and other data held out."""
    rng = np.random.default_rng(seed)
    slope, signatures = rng.standard_normal((N + HELD, P)), rng.standard_normal((N + HELD, M))
    signatures /= np.linalg.norm(signatures[:N], axis=0)
    truth = rng.standard_normal(P)
    data = slope @ truth + signatures @ (size * rng.standard_normal(M)) + rng.standard_normal(N + HELD)
    values = la.lstsq(np.vstack([slope[:N], np.eye(P)]), np.concatenate([data[:N], np.zeros(P)]))[0]
    names = tuple(f"p{k}" for k in range(P))
    residual = data - slope @ values
    space = {name: SimpleNamespace(lower=-50.0, upper=50.0, unit="-") for name in names}
    fit = LinearisedFit(
        (), SimpleNamespace(space=space), names, dict(zip(names, values.tolist(), strict=True)),
        residual[:N], slope[:N], np.ones(P), values, True,
    )  # fmt: skip
    scores = scored(fit, [f"c{k}" for k in range(M)], [{}] * M, signatures[:N], np.ones(M, bool), np.zeros(M))
    labels = [ModalRow("1B", "shape", f"s{k}", "re") for k in range(HELD)]
    held = HeldOut(
        labels, data[N:], np.ones(HELD), np.zeros(HELD, bool), residual[N:], names, slope[N:],
        slope[N:] @ la.cholesky(fit.covariance, lower=True),
    )  # fmt: skip
    return held, discrepancy(fit, scores), signatures[N:]


@pytest.mark.medium
def test_most_measured_values_lie_inside_where_those_of_the_fit_alone_do_not():
    """Of 2000 values at least 95 % within three standard deviations of a count, as the size is an upper limit."""
    alone = together = 0
    for seed in range(100):
        held, wide, changes = world(seed, 3.0)
        table, errors = prediction_tables({"held_out_sensors": held}, wide, {"held_out_sensors": changes})
        alone, together = alone + int(table["inside"].sum()), together + int(table["inside_unexplained"].sum())
        assert errors["expected_unexplained"][0] > errors["expected"][0]
    assert alone < 0.75 * 2000 and together > 0.93 * 2000


def test_without_a_misfit_the_intervals_are_little_wider():
    width = []
    for seed in range(20):
        held, wide, changes = world(seed, 0.0)
        table, _ = prediction_tables({"held_out_sensors": held}, wide, {"held_out_sensors": changes})
        width += ((table["high_unexplained"] - table["low_unexplained"]) / (table["high"] - table["low"])).tolist()
    assert 1.0 < np.median(width) < 1.6


def test_interval_and_error_are_those_of_the_covariance():
    held, wide, changes = world(4, 3.0)
    table, errors = prediction_tables({"held_out_sensors": held}, wide, {"held_out_sensors": changes})
    mean, added = wide.elsewhere(held.names, held.slope, changes)
    residual = held.residual
    np.testing.assert_allclose(table["predicted"], held.value - residual)
    assert errors["rms"][0] == pytest.approx(np.sqrt(np.mean(residual**2)))
    for end, more in {"": np.zeros((HELD, HELD)), "_unexplained": added @ added.T + np.outer(mean, mean)}.items():
        covariance = np.eye(HELD) + held.spread @ held.spread.T + more
        half = 1.96 * np.sqrt(np.diag(covariance))
        np.testing.assert_allclose(table[f"low{end}"], held.value - residual - half)
        np.testing.assert_allclose(table[f"high{end}"], held.value - residual + half)
        assert table[f"inside{end}"].tolist() == (np.abs(residual) <= half).tolist()
        assert errors[f"expected{end}"][0] == pytest.approx(np.sqrt(np.trace(covariance) / HELD))
        chance = chi2.sf(residual @ la.solve(covariance, residual), HELD)
        assert errors[f"p{end}"][0] == pytest.approx(chance, rel=1e-6)


def test_frequencies_have_intervals_of_their_logarithm_and_lost_modes_none():
    held, wide, _ = world(4, 3.0)
    few = HeldOut(
        [ModalRow("1B", "frequency"), ModalRow("2B", "frequency"), ModalRow("1B", "shape", "s1", "im")],
        np.array([10.0, 20.0, 0.5]),
        np.array([0.01, 0.01, 0.02]), np.array([True, True, False]), np.array([2.0, 100.0, 2.0]), held.names,
        np.zeros((3, P)), np.zeros((3, 0)), lost=np.array([False, True, False]),
    )  # fmt: skip
    table, errors = prediction_tables({"held_out_modes": few}, wide, {"held_out_modes": np.zeros((3, M))})
    assert table["mode"].tolist() == ["1B", "1B"] and table["sensor"].tolist() == ["", "s1"]
    assert errors["rows"].tolist() == [3]  # an unpaired mode counts in the errors
    np.testing.assert_allclose(table["predicted"], [10.0 * np.exp(-0.02), 0.5 - 0.04])
    np.testing.assert_allclose(table["low"], [10.0 * np.exp(-0.02 - 0.0196), 0.46 - 0.0392])
    np.testing.assert_allclose(table["high"], [10.0 * np.exp(-0.02 + 0.0196), 0.46 + 0.0392])
    assert table["inside"].tolist() == [False, False] == table["inside_unexplained"].tolist()


@pytest.mark.parametrize("lost", [True, False])
def test_where_every_row_is_lost_there_are_neither_predictions_nor_errors(lost):
    """A second group with predictions keeps the errors of both."""
    held, wide, changes = world(4, 3.0)
    none = replace(held, lost=np.ones(HELD, bool))
    groups = {"held_out_modes": none, "held_out_sensors": replace(held, lost=np.full(HELD, lost))}
    table, errors = prediction_tables(groups, wide, dict.fromkeys(groups, changes))
    assert len(table) == (0 if lost else HELD)
    assert errors["group"].tolist() == ([] if lost else list(groups)) and list(errors) == list(ERROR_COLUMNS)


def test_the_sentence_counts_what_lies_inside():
    held, wide, changes = world(4, 3.0)
    table, errors = prediction_tables({"held_out_sensors": held}, wide, {"held_out_sensors": changes})
    inside, beside = int(table["inside"].sum()), int(table["inside_unexplained"].sum())
    assert f"validation sensors {inside} and {beside} of {HELD} (rms error " in predictions_sentence(table, errors)
    assert predictions_sentence(pd.DataFrame(), pd.DataFrame(columns=list(ERROR_COLUMNS))) == ""
