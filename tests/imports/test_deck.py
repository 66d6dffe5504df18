"""Templates of decks: values in fields of a code, and expressions that fail."""

import numpy as np
import pytest

from calib.errors.errors import EvaluationError
from calib.imports.deck import deck_of, in_columns
from calib.problem.parameter import Parameter

STIFFNESS = Parameter("k", 1.0, 0.5, 2.0)


@pytest.mark.parametrize(("columns", "digits"), [(8, 5e-3), (16, 1e-8)])
def test_a_number_fits_a_field_of_nastran_and_loses_no_digit_that_has_room(columns, digits):
    rng = np.random.default_rng(1)
    for value in (10.0 ** rng.uniform(-12, 12, 300) * rng.choice([-1.0, 1.0], 300)).tolist():
        text = in_columns(value, columns)
        assert len(text) <= columns and ("." in text or "E" in text.upper() or "+" in text[1:] or "-" in text[1:])
        assert read(text) == pytest.approx(value, rel=digits)


def read(text):
    """A number of Nastran, whose exponent may stand without its letter (Quick Reference Guide, real numbers)."""
    head, sign = text[0], text[1:]
    for mark in "+-":
        if mark in sign and "E" not in sign.upper():
            sign = sign.replace(mark, f"E{mark}")
    return float(head + sign)


def test_lines_of_nastran_and_of_apdl_get_the_calibrated_values():
    bulk = "CELAS2  1       {{ (2e5 * k) | columns(8) }}1       1       2       1"
    assert deck_of(bulk, [STIFFNESS], {"k": 1.25}) == "CELAS2  1       250000.01       1       2       1"
    assert deck_of("MP,EX,1,{{ 2.1e11 * k }}", [STIFFNESS], {"k": 1.25}) == "MP,EX,1,262500000000.0"


def test_a_filter_before_a_product_is_told_with_its_line():
    with pytest.raises(EvaluationError, match=r"line 2, cannot be written .* A filter acts before \* and \+"):
        deck_of("$ springs\nCELAS2  1       {{ 2e5 * k | columns(8) }}", [STIFFNESS], {"k": 1.25})
    with pytest.raises(EvaluationError, match=r"line 1, cannot be written \(ZeroDivisionError: [^)]*\)$"):
        deck_of("{{ 1 / (k - k) }}", [STIFFNESS], {"k": 1.25})
