"""Parameters of the car against Table 1 of the case study, and the marks of assumed values."""

import pytest

from calib import LinearConstraint, ParameterSpace
from models.railway.parameters import BOGIE, CAR, RIG

# symbol: name, nominal, lower, upper, unit; None where it is lost.
PUBLISHED = {
    "KS1": ("K_secondary_front", None, 242, 270.8, "kN/m"),
    "KS2": ("K_secondary_rear", None, 242, 270.8, "kN/m"),
    "cS": ("c_secondary", None, None, None, "kNs/m"),
    "cAL": ("c_yaw", None, None, None, "kNs/m"),
    "Kb": ("K_rod_tilting", 20_000, 5_000, 35_000, "kN/m"),
    "rho_alu": ("rho_aluminium", 2700, None, None, "kg/m3"),
    "E_alu": ("E_aluminium", 70, None, None, "GPa"),
    "RMIb": ("RMI_base", None, 50, 400, "-"),
    "RMIp": ("RMI_walls", None, None, None, "-"),
    "RMIc": ("RMI_cover", None, None, None, "-"),
    "Mb": ("m_base", 70, 50, 90, "%"),
    "Mp": ("m_walls", 20, 5, 35, "%"),
    "Mc": ("m_cover", 10, 0, 15, "%"),
    "e_bas": ("t_base", 10.2, None, None, "mm"),
    "e_par": ("t_walls", 10.3, None, None, "mm"),
    "e_cob": ("t_cover", 8.8, None, None, "mm"),
}
PRINTED_MEAN = {"KS1": 256.4, "KS2": 256.4, "cS": 35, "cAL": 400, "RMIb": 225, "RMIp": 90, "RMIc": 300}
UNIFORM = {"KS1": (256.4, 8.3), "KS2": (256.4, 8.3), "Kb": (20_000, 8_660), "RMIb": (225, 101), "Mb": (70, 11.5),
           "Mp": (20, 8.7), "Mc": (7.5, 4.3)}  # fmt: skip
DETERMINISTIC = {"rho_alu", "E_alu", "e_bas", "e_par", "e_cob"}

BY_SYMBOL = {p.symbol: p for p in CAR}


@pytest.mark.medium
def test_table_is_complete_and_names_are_unique(car):
    assert list(BY_SYMBOL) == list(PUBLISHED)
    assert all(p.source.endswith("Table 1") and p.description for p in CAR)
    names = [p.name for p in CAR + BOGIE + RIG]
    assert len(set(names)) == len(names)
    assert car.space.names == tuple(p.name for p in CAR + BOGIE)


@pytest.mark.parametrize("symbol", PUBLISHED)
def test_published_numbers_are_kept(symbol, assert_published):
    p, (_, nominal, lower, _, _) = BY_SYMBOL[symbol], PUBLISHED[symbol]
    assert_published(p, PUBLISHED[symbol], symbol in DETERMINISTIC)
    assert ("nominal value" in p.assumed) == (nominal is None)
    assert ("limits" in p.assumed) == (lower is None)


@pytest.mark.parametrize("symbol", PRINTED_MEAN)
def test_lost_nominal_values_take_the_printed_mean(symbol):
    assert BY_SYMBOL[symbol].value == PRINTED_MEAN[symbol]


@pytest.mark.parametrize("symbol", UNIFORM)
def test_limits_have_the_printed_mean_and_deviation(symbol):
    mean, deviation = UNIFORM[symbol]
    p = BY_SYMBOL[symbol]
    assert (p.lower + p.upper) / 2 == pytest.approx(mean)
    assert p.prior_width == pytest.approx(deviation, rel=0.01)


def test_nominal_shares_of_the_further_equipment_make_a_whole():
    names = ("m_base", "m_walls", "m_cover")
    space = ParameterSpace(CAR, (LinearConstraint("further equipment", tuple((n, 1.0) for n in names), 90, 110, "%"),))
    assert sum(space[n].value for n in names) == 100
    space.require_feasible()


@pytest.mark.medium
def test_assumptions_of_the_vehicle_are_listed_once_each_with_a_reason(car):
    items = [a.item for a in car.assumptions]
    assert len(set(items)) == len(items)
    for assumption in car.assumptions:
        for text in (assumption.item, assumption.value, assumption.unit, assumption.reason):
            assert text.strip()
