"""What was measured under one condition, by kind, and the forward problem of a model against it."""

from calib.experiment.frf import FRFTest
from calib.experiment.modal import ModalTest
from calib.experiment.response import ResponseTest
from calib.experiment.test import Test

TESTS = (ModalTest, ResponseTest, FRFTest)
"""The kinds that the messages name; any other subclass of `Test` serves as well."""

__all__ = ["TESTS", "FRFTest", "ModalTest", "ResponseTest", "Test"]
