"""What an effect takes from the sum of squares of each of several tests."""

from types import SimpleNamespace

import numpy as np
import pytest

from calib.missing.candidate_fit import CandidateFit
from calib.missing.pattern import reduction_table


def fit_of(residual, prior=0.0):
    e = np.array(residual, dtype=float)
    return SimpleNamespace(residual=e, misfit=float(e @ e) + prior)


def found_of(*others, verdict="effect", names_something=True):
    """The base model, which leaves (3, 4), (1,) and (2,), and fits with one effect each, the first one chosen."""
    fits = [CandidateFit((SimpleNamespace(name=name),), fit_of(*own), 0.0, "") for name, own in others]
    base = CandidateFit((), fit_of([3.0, 4.0, 1.0, 2.0], 5.0), 0.0, "")
    return SimpleNamespace(
        base=base, chosen=fits[0] if fits else None, verdict=verdict, names_something=names_something,
        credible=tuple(f.names[0] for f in fits), singles=fits,
    )  # fmt: skip


TESTS = ["one", "one", "two", "three"]


def test_shares_of_tests_and_priors_add_up():
    table = reduction_table(found_of(("lamp", ([3.0, 0.0, 2.0, 0.0], 2.0))), TESTS).set_index("test")
    assert table["rows"].tolist() == [2, 1, 1]
    assert table[["before", "after"]].to_numpy().tolist() == [[25.0, 9.0], [1.0, 4.0], [4.0, 0.0]]
    assert table["share"].tolist() == pytest.approx([16 / 20, -3 / 20, 4 / 20])
    assert table["share"].sum() + 3 / 20 == pytest.approx(1.0)  # the priors had 5 and have 2
    assert table["shown_first"].tolist() == [True, False, False]


def test_the_test_with_the_largest_share_is_shown_first_only_where_an_effect_is_named():
    fit = ("lamp", ([3.0, 3.9, 0.0, 0.0], 5.0))
    assert reduction_table(found_of(fit), TESTS).set_index("test")["shown_first"].idxmax() == "three"
    attempt = reduction_table(found_of(fit, verdict="partial", names_something=False), TESTS)
    assert not attempt["shown_first"].any() and len(attempt) == 3


def test_of_indistinguishable_effects_the_chosen_one_decides():
    two = (("lamp", ([3.0, 0.0, 1.0, 2.0], 5.0)), ("rug", ([3.0, 4.0, 1.0, 0.0], 5.0)))
    table = reduction_table(found_of(*two, verdict="indistinguishable"), TESTS)
    assert table.loc[table["shown_first"], ["effects", "test"]].to_numpy().tolist() == [["lamp", "one"]]


def test_without_a_decrease_there_is_no_share():
    found = found_of(("lamp", ([3.0, 4.0, 1.0, 2.0], 5.0)))
    table = reduction_table(found, TESTS)
    assert table["share"].isna().all() and not table["shown_first"].any()
    nothing = reduction_table(found_of(), TESTS)
    assert nothing.empty and "shown_first" in nothing
