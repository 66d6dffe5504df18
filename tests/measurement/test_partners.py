"""Tests of `calib.measurement.partners`: which model node belongs to a measured one, and what is told or refused."""

from __future__ import annotations

import numpy as np
import pytest

from calib.errors.errors import InputError
from calib.measurement.partners import PARTNER_COLUMNS, node_partners
from calib.measurement.rules import RULES

_PLATE = {
    101 + 11 * i + j: (0.1 * i, 0.1 * j, 0.0) for i in range(21) for j in range(11)
}  # 2 m by 1 m, a node every 0.1 m
_SIZE = 2.0


def plate_node(i: int, j: int) -> int:
    return 101 + 11 * i + j


def test_numbers_need_not_agree_and_offsets_are_told():
    measured = {1: (0.0, 0.0, 0.004), 2: (1.01, 0.48, 0.0), 3: (2.0, 1.0, 0.0)}
    found = node_partners(measured, _PLATE)
    assert found.of == {1: plate_node(0, 0), 2: plate_node(10, 5), 3: plate_node(20, 10)}
    assert tuple(found.table.columns) == PARTNER_COLUMNS
    assert found.table["distance"].to_numpy() == pytest.approx([0.004, np.hypot(0.01, 0.02), 0.0])
    assert found.table["limit"].to_numpy() == pytest.approx(0.5 * 0.1, rel=1e-4)
    assert found.warnings == ()
    assert found.require("plate") is found


@pytest.mark.parametrize("spacing", [0.01, 0.1, 1.0])
def test_the_limit_follows_the_size_of_the_model_and_the_spacing_of_its_nodes(spacing):
    line = {k: (spacing * k, 0.0, 0.0) for k in range(round(2.0 / spacing) + 1)}
    (limit,) = node_partners({1: (0.0, 0.0, 0.0)}, line).table["limit"]
    assert limit == pytest.approx(max(RULES.partner_size * 2.0, RULES.partner_spacing * spacing), rel=1e-4)


def test_the_spacing_is_that_at_the_partner_and_nodes_that_coincide_have_none():
    uneven = {1: (0.0, 0.0, 0.0), 2: (0.0, 0.0, 0.0), 3: (0.02, 0.0, 0.0), 4: (1.0, 0.0, 0.0), 5: (2.0, 0.0, 0.0)}
    limits = node_partners({1: (0.0, 0.0, 0.0), 2: (2.0, 0.0, 0.0)}, uneven).table["limit"]
    assert limits.to_numpy() == pytest.approx([RULES.partner_size * 2.0, RULES.partner_spacing * 1.0], rel=1e-4)


def test_a_node_beyond_its_limit_is_refused_with_distance_partner_and_limit():
    measured = {1: (0.0, 0.0, 0.0), 2: (1.0, 0.5, 0.3), 3: (2.0, 1.0, 0.0), 4: (0.0, 1.0, 0.2)}
    found = node_partners(measured, _PLATE)
    assert set(found.of) == {1, 3}
    with pytest.raises(InputError) as caught:
        found.require("plate")
    words = str(caught.value)
    assert "2 of 4" in words and "node_limit" in words
    assert f"node 2 by 300 mm from node {plate_node(10, 5)} (limit 50 mm)" in words
    assert words.index("node 2 by") < words.index("node 4 by")  # the worst first
    assert node_partners(measured, _PLATE, limit=0.31).require("plate").of[2] == plate_node(10, 5)
    with pytest.raises(InputError, match="sensor 1"):
        node_partners({1: (0.0, 0.0, 0.004)}, _PLATE, limit=0.003).require("plate")


@pytest.mark.parametrize("limit", [0.0, -1.0, float("nan"), float("inf")])
def test_a_limit_is_a_positive_length(limit):
    with pytest.raises(InputError, match="node_limit"):
        node_partners({1: (0.0, 0.0, 0.0)}, _PLATE, limit)


def test_a_model_without_places_has_no_partners():
    with pytest.raises(InputError, match="coordinates"):
        node_partners({1: (0.0, 0.0, 0.0)}, {})


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "mm"), (100.0, "cm"), (1 / 0.0254, "inches"), (1 / 0.3048, "feet")])
def test_measured_places_in_another_unit_are_noticed(factor, unit):
    measured = {k: tuple(factor * c for c in _PLATE[plate_node(5 * k, 5)]) for k in range(5)}
    found = node_partners(measured, _PLATE)
    assert found.unit == f"measured places in {unit}"
    with pytest.raises(InputError, match=f"measured places in {unit}"):
        found.require("plate")


@pytest.mark.parametrize("first", [0, 1])
def test_a_model_in_millimetres_is_noticed_though_every_distance_is_within_its_limit(first):
    large = {node: tuple(1e3 * c for c in place) for node, place in _PLATE.items()}
    measured = {k: _PLATE[plate_node(5 * k, first)] for k in range(5)}
    found = node_partners(measured, large)
    assert (found.table["distance"] <= found.table["limit"]).all()
    with pytest.raises(InputError, match="places of the model in mm, or the other side in a wrong unit"):
        found.require("plate")


def test_sensors_close_to_each_other_are_no_other_unit():
    measured = {1: (1.0, 0.5, 0.0), 2: (1.01, 0.5, 0.0), 3: (1.0, 0.51, 0.0), 4: (1.01, 0.51, 0.0)}
    found = node_partners(measured, _PLATE)
    assert found.unit == ""
    (words,) = found.warnings
    assert "1, 2, 3, 4" in words and str(plate_node(10, 5)) in words
    assert set(found.table["remark"]) == {"shares its partner"}


def test_a_node_midway_between_two_is_told_and_one_beside_the_middle_is_not():
    chain = {k: (float(k), 0.0, 0.0) for k in range(1, 6)}
    found = node_partners({7: (2.5, 0.0, 0.0), 8: (4.4, 0.0, 0.0)}, chain, limit=0.6)
    assert found.of == {7: 2, 8: 4}
    assert "node 3 is as near" in found.table["remark"][0] and found.table["remark"][1] == ""
    assert any("node 7 (nodes 2 and 3)" in words for words in found.warnings)
    assert node_partners({7: (2.5, 0.0, 0.0)}, chain).require("chain").of == {7: 2}  # on a line none lies beyond


def test_of_nodes_that_coincide_the_first_is_taken_and_told():
    joint = {4: (1.0, 0.0, 0.0), 9: (0.0, 0.0, 0.0), 5: (0.0, 0.0, 0.0)}
    found = node_partners({1: (0.001, 0.0, 0.0)}, joint)
    assert found.of == {1: 9}
    assert any("node 1 (nodes 9 and 5)" in words for words in found.warnings)


def test_one_node_off_its_number_is_told_where_all_others_agree():
    chain = {k: (float(k), 0.0, 0.0) for k in range(1, 6)}
    measured = {1: chain[1], 2: chain[2], 3: chain[4], 5: chain[5]}
    found = node_partners(measured, chain)
    assert found.of[3] == 4
    assert any("node 3 (on node 4)" in words for words in found.warnings)
    assert "node 3 is 1 m away" in found.table["remark"][2]
    others = {10 * k: place for k, place in chain.items()}
    assert node_partners(measured, others).warnings == ()


def test_a_distance_near_its_limit_is_told():
    found = node_partners({1: (0.0, 0.0, 0.045), 2: (0.0, 0.5, 0.02)}, _PLATE)
    (words,) = found.warnings
    assert "node 1 by 45 mm of 50 mm" in words and "node 2" not in words
    assert "node 1 is the farthest" in found.sentence


def test_a_model_of_one_node_and_no_measured_nodes():
    assert node_partners({3: (0.0, 0.0, 0.0)}, {1: (0.0, 0.0, 0.0)}).of == {3: 1}
    empty = node_partners({}, _PLATE)
    assert empty.of == {} and empty.sentence == "" and empty.require("plate").warnings == ()
