"""The case that a calibration reports: one for all tests."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from calib.analyses.calibration import best_of, summed
from calib.inference.agreement import agreement, agreement_sentences
from calib.inference.cases import CaseResult
from calib.inference.rules import RULES
from calib.problem.problem import Counts
from calib.problem.space import Parameter, ParameterSpace


def case(misfit, criterion, fitted=True):
    statistics = SimpleNamespace(fit="a fit" if fitted else None, criterion=criterion)
    return SimpleNamespace(result=SimpleNamespace(misfit=misfit), statistics=statistics)


@pytest.mark.parametrize(
    ("misfits", "best"), [(((2.0, 1.0),), 1), (((1.0, 1.2), (3.0, 0.1)), 1), (((1.0, 1.2), (0.1, 3.0)), 0)]
)
def test_of_equal_cases_the_lowest_misfit_over_all_tests_is_reported(misfits, best):
    sums = (5.0, 5.0 + RULES.equal / 2)
    assert best_of([[case(*pair) for pair in zip(own, sums, strict=True)] for own in misfits]) == best


def test_a_lower_sum_of_squares_outweighs_any_misfit():
    assert best_of([[case(1.0, 5.0 + 2 * RULES.equal), case(9.0, 5.0)]]) == 1
    assert best_of([[case(1.0, 1.0, fitted=False), case(9.0, 5.0)]]) == 1


def test_searches_alone_are_compared_by_their_misfit():
    assert best_of([[case(3.0, 1.0, fitted=False), case(2.0, 9.0, fitted=False)]]) == 1


def test_a_test_that_discriminates_makes_the_joint_solution_unique():
    """The first test fits both values of the parameter equally well; the second only one."""
    space = ParameterSpace((Parameter("a", 0.5, -3.0, 3.0),))

    def ended(*misfits):
        return [
            SimpleNamespace(result=replace(CaseResult.fitted(f"C{k}", {"a": a}, Counts(), None, 0.0), misfit=misfit))
            for k, (a, misfit) in enumerate(zip((1.0, -1.0, 1.0), misfits, strict=True))
        ]

    first, second = ended(1.0, 1.0, 1.0), ended(1.0, 9.0, 1.0)
    assert agreement([case.result for case in first], space).differing == {"a": pytest.approx(1 / 3)}
    both = agreement(summed([first, second]), space)
    assert both.verdict == "one solution" and not both.differing and both.worse == ("C1",)


def agreed(*ends):
    """Agreement of cases that end at these values of one parameter, with equal misfits."""
    space = ParameterSpace((Parameter("a", 0.5, -3.0, 3.0),))
    cases = [CaseResult.fitted(f"C{k}", {"a": a}, Counts(), None, 0.0) for k, a in enumerate(ends, start=1)]
    return agreement([replace(case, misfit=1.0) for case in cases], space)


def test_searches_that_least_squares_leads_to_one_solution_are_no_second_solution():
    apart, one = agreed(-1.0, 1.0), agreed(0.5, 0.5)
    first, second = agreement_sentences(one, apart)
    assert "one solution" in first and "not unique" not in first + second
    assert "2 places" in second and "33 % of the search range" in second and "(a)" in second
    assert "not unique" in " ".join(agreement_sentences(apart, apart))
    assert agreement_sentences(one, None) == (one.sentence,)
    lonely = agreed(0.5)
    assert agreement_sentences(lonely, None) == (lonely.sentence, *([lonely.remedy] if lonely.remedy else []))
    assert agreement_sentences(None, None) == ()
    (told,) = agreement_sentences(None, apart)  # one start alone met the data as well as the reported fit
    assert apart.sentence[1:] in told and told != apart.sentence
