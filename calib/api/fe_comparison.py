"""Computed modes against measured ones, without matrices, parameters or a study: the first table of MAC."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from calib.analyses.compare import ComparisonResult
from calib.api.display import Compared, compared
from calib.errors.arguments import path as path_of
from calib.errors.errors import InputError
from calib.experiment import ModalTest
from calib.imports.elements import Edge
from calib.imports.fe_modes import element_lines, read_fe_modes
from calib.measurement.files.read import read_modes
from calib.measurement.modal import DIRECTIONS, MeasuredModes, Sensor
from calib.measurement.partners import NodePartners, node_partners
from calib.measurement.places import Point
from calib.problem.space import ParameterSpace
from calib.results.results import Results
from calib.structure.modal_function import ModalFunctionModel

Given: TypeAlias = str | Path | MeasuredModes

DRAWN = 1000
"""Computed nodes without a measured one that figures show: pages with tens of thousands take minutes."""
NAME = "computed modes"
"""Name of the model in tables and messages."""


def compare_modes(
    modes: Given,
    measured: Given | Sequence[str | Path] | ModalTest,
    *,
    shapes: str | Path | Sequence[str | Path] = (),
    sensors: str | Path | None = None,
    coordinates: str | Path | None = None,
    modes_shapes: str | Path | None = None,
    length_unit: str | None = None,
    measured_length_unit: str | None = None,
    node_limit: float | None = None,
) -> Compared:
    """Compare the modes that a finite-element code has computed with measured ones: MAC, pairs, frequency errors.

    Neither matrices nor parameters are needed. Measured nodes belong to the nearest computed ones where both have
    coordinates (see `calib.measurement.partners.node_partners`), else to those of the same number.

    Parameters
    ----------
    modes : path or MeasuredModes
        Computed modes: a universal file, CalculiX .frd or .dat, Nastran .f06, Abaqus .fil or .dat, a listing of ANSYS,
        a modes table (.csv), or those of `calib.modes`; see `calib.imports.fe_modes.read_fe_modes`.
    measured : path, sequence of paths, MeasuredModes or ModalTest
        As `calib.read_modes` takes them.
    shapes, sensors : path, optional
        Tables of measured shapes and of places of measured nodes, m, beside tables of modes.
    coordinates : path, optional
        Places of computed nodes where the file of modes has none: a table ``node, x, y, z`` in m or a deck.
    modes_shapes : path, optional
        Shapes table beside a table of computed modes.
    length_unit : str, optional
        Of coordinates of computed nodes where no file states it, such as ``mm``.
    measured_length_unit : str, optional
        Likewise of measured ones in universal files; tables are in m.
    node_limit : float, optional
        Largest distance between a measured node and its computed one, m.

    Returns
    -------
    Compared
        Prints pairs and errors; ``table``, ``sentences``, ``report(path)``.

    Raises
    ------
    InputError
        For files that cannot be read, fewer computed than measured modes, and measured nodes or directions without a
        computed one.

    Examples
    --------
    A beam on two supports, with an error of the second frequency:

    >>> import numpy as np
    >>> import calib
    >>> shapes = np.sin(np.pi * np.outer([0.2, 0.5, 0.7], [1, 2]))
    >>> fe = calib.modes([10.0, 40.0], shapes, sensors=["1z", "2z", "3z"])
    >>> test = calib.modes([10.1, 38.0], -shapes, sensors=["1z", "2z", "3z"])
    >>> calib.compare_modes(fe, test).table[["mode", "model_mode", "mac"]].round(3).values.tolist()
    [['1', 1, 1.0], ['2', 2, 1.0]]
    """
    computed = modes if isinstance(modes, MeasuredModes) else read_fe_modes(
        path_of(modes, "modes"),
        shapes=None if modes_shapes is None else path_of(modes_shapes, "modes_shapes"),
        coordinates=None if coordinates is None else path_of(coordinates, "coordinates"),
        length_unit=length_unit,
    )  # fmt: skip
    if length_unit is not None and not any(s.point or DIRECTIONS.index(s.direction) > 2 for s in computed.sensors):
        raise InputError(
            f"length_unit ({length_unit}) is that of computed nodes, and it has no places of nodes", place=str(modes),
            remedy="name the file that has them, coordinates (--coordinates), or leave length_unit out",
        )  # fmt: skip
    test = _test(measured, shapes, sensors, measured_length_unit, computed.n_modes, node_limit)
    if computed.n_modes < test.used.n_modes:
        raise InputError(
            f"{computed.n_modes} modes are computed, and {test.used.n_modes} were measured",
            place=computed.source or "modes", remedy="compute at least as many, better twice as many",
        )  # fmt: skip
    files = [None if one is None or isinstance(one, MeasuredModes) else Path(one) for one in (modes, coordinates)]
    model, partners = model_of_modes(computed, test.measured, test.node_limit, element_lines(files))
    found = compared(_problem(model, test), None)
    by_test = {name: _with_own_numbers(answer, partners) for name, answer in found.by_test.items()}
    sides = {"measured (--sensors)": test.measured.sensors, "computed (--coordinates)": computed.sensors}
    lacking = " and ".join(side for side, own in sides.items() if not any(s.point for s in own))
    by_number = f"Nodes belong together by their numbers, since {lacking} nodes have no coordinates."
    matched = by_number if partners is None and test.measured.has_shapes else partners.sentence if partners else ""
    notes = (*computed.notes, matched)
    return Compared(by_test, found.studies, tuple(note for note in notes if note))


def _with_own_numbers(answer: ComparisonResult, partners: NodePartners | None) -> ComparisonResult:
    """The result with the code's own node numbers; the model that is compared has those of the measured nodes."""
    if partners is None or answer.partners is None:
        return answer
    renumbered = {f"Check this: {words}" for words in answer.partners.warnings}
    hints = (
        *(f"Check this: {words}" for words in partners.warnings),
        *(h for h in answer.hints if h not in renumbered),
    )
    return replace(answer, hints=hints, partners=partners)


def compare_files(
    study: Path | None, modes: Path | None, measured: Sequence[Path], into: Path, **options: Any
) -> tuple[Compared, tuple[Path, ...]]:
    """As `compare_modes`, for the command: writes ``report.html`` and the tables into a folder; returns the files.

    Raises
    ------
    InputError
        Also where a study is named beside the files, or one of the two kinds of files is missing.
    """
    if study is not None:
        model = f"--modes {study} if it is the model's, else " if modes is None else ""
        remedy = (
            f"name it with an option of its own, {model}--measured {study}, or all measured ones by a pattern in quotes"
        )
        if study.is_dir() or not study.exists():
            raise InputError("it is named beside files", place=f"study {study}", remedy="name the study, or the files")
        raise InputError("no option names it", place=study, remedy=remedy)
    if modes is None or not measured:
        name = "modes" if modes is None else "measured"
        raise InputError("no file is named", place=f"--{name}", remedy="give computed and measured modes")
    given = {name: value for name, value in options.items() if value is not None}
    found = compare_modes(modes, list(measured), **given)
    (answer,) = found.by_test.values()
    home = Results(into)
    if (into / "comparison.csv").exists():
        told = f"This replaces an earlier comparison in {into}; --into NAME keeps both."
        found = replace(found, notes=(*found.notes, told))
    try:
        home.path.mkdir(parents=True, exist_ok=True)
    except OSError as fault:
        raise InputError(f"it is no folder ({fault.strerror})", place=into, remedy="name another one: --into") from None
    home.write_table("comparison", answer.table)
    if answer.comparison is not None and answer.comparison.measured.has_shapes:
        home.write_table("mac", answer.comparison.mac_table())
        home.write_table("shapes", answer.comparison.shapes_table())
    return found, found.report(into / "report.html")


def _problem(model: ModalFunctionModel, test: ModalTest) -> Any:
    from calib.api.problem import Problem

    return Problem(model, test)


def _test(
    measured: Any, shapes: Any, sensors: Any, length_unit: str | None, count: int, node_limit: float | None
) -> ModalTest:
    """The measured modes as a test, with all computed modes available for pairs."""
    if isinstance(measured, ModalTest):
        return measured if node_limit is None else replace(measured, node_limit=node_limit)
    read = measured if isinstance(measured, MeasuredModes) else read_modes(
        measured, shapes=shapes, sensors=sensors, length_unit=length_unit
    )  # fmt: skip
    return ModalTest(read, mode_count=max(count, read.n_modes), node_limit=node_limit)


def model_of_modes(
    computed: MeasuredModes, measured: MeasuredModes, node_limit: float | None = None, lines: Sequence[Edge] = ()
) -> tuple[ModalFunctionModel, NodePartners | None]:
    """Computed modes as a model without parameters, whose sensors bear the numbers of the measured nodes.

    Other computed nodes are kept for figures, `DRAWN` of them at most, under numbers that no measured node has.

    Parameters
    ----------
    computed, measured : MeasuredModes
    node_limit : float, optional
        See `compare_modes`.
    lines : sequence of (int, int)
        Pairs of computed nodes that an edge of an element joins.

    Returns
    -------
    model : ModalFunctionModel
    partners : NodePartners or None
        Of measured nodes by distance; None where either side has no coordinates, and numbers count.
    """
    if measured.has_shapes and not computed.has_shapes:
        raise InputError(
            "the measured modes have shapes, and the computed ones have none", place=computed.source or "modes",
            remedy="give the shapes of a table as modes_shapes (--modes-shapes), or leave the measured ones out",
        )  # fmt: skip
    own, places = _points(measured), _points(computed)
    partners, of = None, {node: node for node in {s.node for s in measured.sensors}}
    if own and places:
        if unplaced := [str(s.node) for s in measured.sensors if s.node not in own]:
            raise InputError(
                f"measured node {unplaced[0]} has no place, and others have", place="sensors",
                remedy="add it to the table of places (--sensors), or take it out of the measured shapes",
            )  # fmt: skip
        partners = node_partners(own, places, node_limit).require(f"of {NAME}")
        of |= partners.of
    rows = {(s.node, s.direction): k for k, s in enumerate(computed.sensors)}
    directions: dict[int, list[str]] = {}
    for node, direction in rows:
        directions.setdefault(node, []).append(direction)
    sensors, index = list[Sensor](), list[int]()
    for node, at in of.items():
        for direction in directions.get(at, ()):
            sensors.append(Sensor(node, direction, places.get(at)))
            index.append(rows[at, direction])
    moved = {s.name for s in sensors}
    if still := [s for s in measured.sensors if s.name not in moved and of[s.node] in directions]:
        node, direction = of[still[0].node], still[0].direction
        raise InputError(
            f"the computed modes have no motion of node {node} along {direction}, only along "
            f"{', '.join(directions[node])}", place=f"sensor {still[0].name}",
            remedy="let the code write it, or take the sensor out of the measured shapes",
        )  # fmt: skip
    if measured.has_shapes and not sensors:
        lacking = " and ".join(side for side, known in (("measured", own), ("computed", places)) if not known)
        remedy = "give those of the computed nodes as coordinates, those of the measured ones as sensors"
        raise InputError(
            f"no measured node has the number of a computed one, and the {lacking} nodes have no coordinates",
            place="sensors", remedy=f"{remedy}, or number them alike",
        )  # fmt: skip
    beyond = max((abs(node) for node in of), default=0) + 1
    taken = set(of.values())
    on_lines = {node for line in lines for node in line}
    others = [node for node in directions if node not in taken and (not lines or node in on_lines)]
    drawn = set(others[:: len(others) // DRAWN + 1])
    for k, s in enumerate(computed.sensors):
        if s.node in drawn:
            sensors.append(Sensor(s.node + beyond, s.direction, s.point))
            index.append(k)
    damped = bool(np.isfinite(computed.damping_ratio).all())
    shapes = computed.shapes[index] if computed.has_shapes else np.ones((1, computed.n_modes))
    shapes = shapes if np.iscomplexobj(shapes) and np.any(np.imag(shapes)) else np.real(shapes)
    result = {"natural_freq": computed.natural_freq, "shapes": shapes}
    result |= {"damping_ratio": computed.damping_ratio} if damped else {}
    known = _Known(result)
    listed = sensors or [Sensor(1, "x")]
    numbers = {node: node + beyond for node in directions if node in drawn} | {at: node for node, at in of.items()}
    joined = tuple((numbers[a], numbers[b]) for a, b in _coarse(lines, {n for n in numbers if n in directions}))
    return ModalFunctionModel(
        NAME, ParameterSpace(()), known, tuple(listed), computed.n_modes, damped, lines=joined
    ), partners  # fmt: skip


def _coarse(lines: Sequence[Edge], kept: set[int]) -> list[Edge]:
    """Pairs of kept nodes that lines join, directly or over nodes that are not kept and nearer to no other one."""
    beside: dict[int, set[int]] = {}
    for a, b in lines:
        beside.setdefault(a, set()).add(b)
        beside.setdefault(b, set()).add(a)
    nearest, front = {node: node for node in kept}, sorted(kept & beside.keys())
    while front:
        grown = list[int]()
        for node in front:
            for other in sorted(beside[node] - nearest.keys()):
                nearest[other] = nearest[node]
                grown.append(other)
        front = grown
    pairs = (sorted((nearest[a], nearest[b])) for a, b in lines if a in nearest)
    return [(a, b) for a, b in dict.fromkeys(map(tuple, pairs)) if a != b]


class _Known:
    """A function of no parameters: the modes as they were read."""

    def __init__(self, result: Mapping[str, np.ndarray]):
        self.result = result

    def __call__(self, values: Mapping[str, float]) -> Mapping[str, np.ndarray]:
        return self.result


def _points(modes: MeasuredModes) -> dict[int, Point]:
    return {s.node: s.point for s in modes.sensors if s.point is not None}
