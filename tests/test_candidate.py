"""Effects and faults of the measurement are the same to ranking, fits and words."""

from dataclasses import fields, replace

import pytest

from calib.correlation.frf.faults import FRFFault
from calib.correlation.modal.faults import ModalFault
from calib.problem.candidate import Candidate, Fault
from calib.problem.effect import Effect
from calib.problem.space import Parameter

SIZE = Parameter("lamp", 0.0, -1.0, 3.0, "kg", prior_sd=0.5)
EFFECT = Effect("lamp", "Lamp", "None.", "A lamp.", SIZE, lambda model: None)
FAULT = Fault(SIZE, "Lamp", "None.", "A lamp.", lambda by: f"{by:g} kg", "gain", "12y")


@pytest.mark.parametrize("one", [EFFECT, FAULT])
def test_each_has_what_a_candidate_needs(one):
    assert [name for name in vars(Candidate) if not name.startswith("_") and not hasattr(one, name)] == []
    assert (one.name, one.names, one.parameters) == ("lamp", ("lamp",), (SIZE,))
    assert (one.signed, one.plausible, one.grid, one.nuisance, one.part) == (True, 0.5, (), (), "")


def test_a_fault_is_of_the_measurement_and_builds_nothing():
    assert FAULT.of_measurement and not EFFECT.of_measurement
    for kind in (Fault, ModalFault, FRFFault):
        assert "build" not in {field.name for field in fields(kind)} | set(vars(kind))
    assert not replace(FAULT, magnitude=replace(SIZE, lower=0.0)).signed and FAULT.told(2.0) == "2 kg"
