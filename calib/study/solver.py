"""A solver as a process: decks with values in them, a command in a private folder, modes or numbers that it wrote."""

from __future__ import annotations

import shlex
import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, TypeVar

from calib.errors.arguments import names, objects
from calib.errors.arguments import path as path_of
from calib.errors.errors import EvaluationError, InputError
from calib.execution.outcome import TOOK_TOO_LONG, point_key
from calib.execution.process import OUTPUT, is_beside, last_lines, program_of, run_command
from calib.execution.temporary import LOCK, TemporaryFolder
from calib.imports.coordinates import DECKS
from calib.imports.deck import deck_name, deck_of, read_template
from calib.imports.fe_modes import read_fe_modes
from calib.imports.keywords import deck_text
from calib.measurement.files.csv_format import read_responses_csv
from calib.measurement.frf_units import LENGTHS
from calib.measurement.modal import MeasuredModes, Sensor
from calib.measurement.partners import node_partners
from calib.problem.parameter import Parameter
from calib.problem.space import ParameterSpace
from calib.results.fingerprint import FAILED_RUNS, digest_of
from calib.structure.function_model import FunctionModel
from calib.structure.modal_function import ModalFunctionModel
from calib.structure.unit_system import SYSTEMS, unit_system

STEP = 2e-3
"""Half step of a difference over the range of a parameter: codes print six or seven digits."""
MODES = 10
"""Modes that a solver computes, where their number is not stated."""
_KEPT = 10
"""Folders of failed runs that are kept."""
_TOLD, _NOTED = 3, 40
"""Last lines of a failed run's output that its failure tells, and those that go with it as a note."""

R = TypeVar("R")


@dataclass(frozen=True, eq=False)
class Solver:
    """A command that solves a deck, as the function of a model.

    Attributes
    ----------
    command : tuple of str
        Program and arguments.
    decks : mapping from name to text
        Templates by the name of the deck that each becomes.
    files : mapping from name to Path
        Copied beside them.
    space : ParameterSpace
    modes, shapes, responses, coordinates : str
        Files of the private folder; empty where there are none.
    matrices : tuple of str
        Likewise, of a run that writes matrices.
    sensors : tuple of Sensor
        Rows of the shapes.
    damped : bool
    units : str
        Unit system of coordinates and matrices.
    time_limit, node_limit : float or None
        Seconds; largest distance of a sensor's node from one of the solver, m.
    folder : Path
        Folders of failed runs are kept below it.
    """

    command: tuple[str, ...]
    decks: Mapping[str, str]
    files: Mapping[str, Path]
    space: ParameterSpace
    modes: str = ""
    shapes: str = ""
    responses: str = ""
    matrices: tuple[str, ...] = ()
    coordinates: str = ""
    sensors: tuple[Sensor, ...] = ()
    damped: bool = False
    units: str = "m-kg-N"
    time_limit: float | None = None
    node_limit: float | None = None
    folder: Path = Path()

    is_transparent: ClassVar[bool] = True
    """See `calib.results.fingerprint.digest_of`: neither the study's folder nor the time limit changes a result."""

    @property
    def __wrapped__(self) -> str:
        return self.identity

    def __call__(self, values: Mapping[str, float]) -> Mapping[str, Any]:
        """Modes at the sensors, or named numbers, at the values of a point.

        Raises
        ------
        EvaluationError
            Where the command fails or takes too long, or does not write what is read; with the last lines of its
            output. Its folder is kept.
        InputError
            Where there is no such program, or where its modes have no motion at a sensor.
        """
        return self.run(values, self._numbers if self.responses else self._modes)

    @property
    def title(self) -> str:
        """The command as it is typed."""
        return shlex.join(self.command)

    @property
    def identity(self) -> str:
        """Hash over all that a result depends on; an installed program counts by name, one of the study by content."""
        content = {name: file.read_bytes() for name, file in self.files.items()}
        reads = (self.modes, self.shapes, self.responses, self.coordinates, self.units, self.damped)
        own = self.folder / self.command[0]
        program = own.read_bytes() if is_beside(self.command[0]) and own.is_file() else self.command[0]
        at = [(s.node, s.direction, s.point) for s in self.sensors]
        integers = [p.name for p in self.space.parameters if p.integer]
        return digest_of("solver 2", program, self.command[1:], dict(self.decks), content, reads, at, integers)[:16]

    def write(self, folder: Path, values: Mapping[str, float], matrices: bool = False) -> None:
        """Write the decks with the values, and copy the other files."""
        for name, text in self.decks.items():
            (folder / name).write_text(deck_of(text, self.space.parameters, values, matrices), "utf-8")
        for name, file in self.files.items():
            shutil.copy2(file, folder / name)

    def run(self, values: Mapping[str, float], read: Callable[[Path], R], matrices: bool = False) -> R:
        """What ``read`` finds in the folder of a run at these values; see `__call__`."""
        with TemporaryFolder() as folder:
            self.write(folder, values, matrices)
            command = program_of(self.command, self.folder, "command")
            try:
                code = run_command(command, folder, self.time_limit)
            except TimeoutError:
                raise self._failed(folder, values, f"{TOOK_TOO_LONG} {self.time_limit:g} s") from None
            name = Path(self.command[0]).name
            if code:
                how = f"was ended by signal {-code}" if code < 0 else f"ended with exit code {code}"
                raise self._failed(folder, values, f"{name} {how}")
            try:
                return read(folder)
            except FileNotFoundError as fault:
                words = f"{name} wrote no {Path(fault.filename or '').name}"
                raise self._failed(folder, values, words) from None
            except (EvaluationError, OSError) as fault:
                raise self._failed(folder, values, f"{name}: {fault}") from None

    # -- results -------------------------------------------------------------------------------------------------------

    def _numbers(self, folder: Path) -> dict[str, float]:
        file = folder / self.responses
        found = read_unless_missing(lambda: read_responses_csv(file), file)
        (only,) = found.values() if len(found) == 1 else ({},)
        if not only:
            raise EvaluationError(f"{self.responses} is no table response, value of one run")
        return {name: value for name, (value, _) in only.items()}

    def computed_modes(self, folder: Path) -> MeasuredModes:
        """The modes that a run wrote, with the places of their nodes where they are known."""
        others = [folder / name for name in (*self.decks, *self.files)]
        place = folder / self.coordinates if self.coordinates else next(filter(_has_nodes, others), None)
        length = next(unit for unit, metres in LENGTHS.items() if metres == SYSTEMS[self.units].length)
        has_own = Path(self.modes).suffix.lower() in (".frd", ".fil", ".unv", ".uff")
        file, shapes = folder / self.modes, folder / self.shapes if self.shapes else None
        at = None if has_own and not self.coordinates else place
        return read_unless_missing(lambda: read_fe_modes(file, shapes=shapes, length_unit=length, coordinates=at), file)

    def _modes(self, folder: Path) -> dict[str, Any]:
        found = self.computed_modes(folder)
        shapes = found.shapes[self._rows(found)]
        shapes = shapes if shapes.imag.any() else shapes.real
        damping = {"damping_ratio": found.damping_ratio} if self.damped else {}
        return {"natural_freq": found.natural_freq, "shapes": shapes, **damping}

    def _rows(self, found: MeasuredModes) -> list[int]:
        """Row of the solver's shapes of each sensor: by the nearest place where all have one, else by node number."""
        points = {s.node: s.point for s in self.sensors if s.point is not None}
        places = {s.node: s.point for s in found.sensors if s.point is not None}
        of: Mapping[int, int] = {}
        if len(points) == len({s.node for s in self.sensors}) and len(places) == len({s.node for s in found.sensors}):
            of = node_partners(points, places, self.node_limit).require(self.modes).of
        rows = {(s.node, s.direction): k for k, s in enumerate(found.sensors)}
        out = []
        for sensor in self.sensors:
            node = of.get(sensor.node, sensor.node)
            if (node, sensor.direction) not in rows:
                raise InputError(
                    f"{self.modes} has no motion of node {node} in {sensor.direction}", place=f"sensor {sensor.name}",
                    remedy="let the code print the displacements of that node, or take it out of the measured shapes",
                )  # fmt: skip
            out.append(rows[node, sensor.direction])
        return out

    # -- failures ------------------------------------------------------------------------------------------------------

    def _failed(self, folder: Path, values: Mapping[str, float], words: str) -> EvaluationError:
        """The failure of a run, with the last lines of its output; its folder is kept."""
        text = (folder / OUTPUT).read_text("utf-8", errors="replace") if (folder / OUTPUT).is_file() else ""
        lines = last_lines(text, _NOTED)
        said = f"; its last lines: {' | '.join(lines[-_TOLD:])}" if lines else "; it printed nothing"
        kept = f" ({FAILED_RUNS} keeps up to {_KEPT} folders)" if self._keep(folder, values) else ""
        fault = EvaluationError(words + said[:300] + kept)
        fault.add_note("\n".join(lines))
        return fault

    def _keep(self, folder: Path, values: Mapping[str, float]) -> bool:
        """Keep the folder of a failed run, one for a point, unless enough are kept; False where that cannot be.

        The same answer whether it is among them: which ones are depends on the order in which workers end.
        """
        home = self.folder / FAILED_RUNS
        own = home / point_key(values)[:8]
        with suppress(OSError):
            shutil.rmtree(own, ignore_errors=True)
            own.mkdir(parents=True)
            if len(list(home.iterdir())) > _KEPT:
                own.rmdir()
                return True
            for item in folder.iterdir():
                if item.name != LOCK:
                    shutil.move(item, own / item.name)
            rows = ["parameter,value", *(f"{n},{float(v)!r}" for n, v in values.items())]
            (own / "values.csv").write_text("\n".join(rows))
            return True
        return False


def read_unless_missing(read: Callable[[], R], *files: Path) -> R:
    """What is read from files that a run wrote; FileNotFoundError without one, EvaluationError where one is damaged."""
    for file in files:
        if not file.is_file():
            raise FileNotFoundError(2, "no such file", file.name)
    try:
        return read()
    except InputError as fault:
        raise EvaluationError(f"{', '.join(file.name for file in files)}: {fault.problem}") from None


def _has_nodes(file: Path) -> bool:
    """Whether a file is a deck that defines nodes."""
    if file.suffix.lower() not in DECKS:
        return False
    try:
        return any(line.upper().lstrip().startswith(("*NODE", "GRID")) for line in deck_text(file).splitlines())
    except InputError:  # of what it includes, the solver tells more
        return False


def solver_model(
    command: str | Sequence[str],
    *,
    template: str | Path | Sequence[str | Path],
    parameters: Sequence[Parameter],
    modes: str = "",
    shapes: str = "",
    responses: str = "",
    matrices: str | Sequence[str] = (),
    files: str | Path | Sequence[str | Path] = (),
    coordinates: str = "",
    units: str = "m-kg-N",
    sensors: Sequence[Any] = (),
    n_modes: int = MODES,
    damped: bool = False,
    step: float = STEP,
    time_limit: float | None = None,
    node_limit: float | None = None,
    folder: str | Path = ".",
    name: str = "",
) -> ModalFunctionModel | FunctionModel:
    """A solver that is started for every evaluation, as a model of modes or of plain numbers.

    Every run has a private folder with the decks, in which ``{{ parameter }}`` is replaced by its value, and with the
    other files. What the command leaves running is ended. Failed runs are failed points, with the last lines of the
    output; ten of their folders are kept in ``failed_runs``.

    Parameters
    ----------
    command : str or sequence of str
        Such as ``"ccx -i job"``; no shell reads it.
    template : path or sequence of paths
        Decks with ``{{ parameter }}``, or an expression such as ``{{ 0.5 * t }}``; ``{{ E | columns(8) }}`` fits a
        field. The deck is named like its template, without ``.j2``.
    parameters : sequence of Parameter
        In the units of the deck.
    modes : str
        File with modes that the command writes; see `calib.compare_modes` for the kinds that are read. ``shapes`` is
        the table beside a modes table.
    responses : str
        Instead of modes a table ``response, value`` that it writes.
    matrices : str or sequence of str
        Files with matrices that it writes where ``matrices`` is true in the template; see `calib.import_matrices`.
    files : path or sequence of paths
        Copied into the folder: meshes, scripts.
    coordinates : str
        File in the folder with places of nodes, where neither modes nor decks have them.
    units : {"m-kg-N", "mm-t-N", "mm-kg-mN", "in-lbf", "in-kip", "ft-lbf"}
        Of coordinates and matrices.
    sensors : sequence of Sensor, of (node, direction), or of names like ``12y``
        Motions that are compared; nodes are found by place where both have one, else by number.
    n_modes : int
        Modes that the command computes without rigid-body modes, at least.
    damped : bool
        Whether their damping ratios are compared.
    step : float
        Half step of a difference, over the range of a parameter; see `calib.ModalFunctionModel`.
    time_limit, node_limit : float, optional
        Seconds of a run; largest distance of a sensor's node from one of the solver, m, by default from the mesh.
    folder : path
        Paths are relative to it.
    name : str
        By default that of the program.

    Raises
    ------
    InputError
        For a wrong template, a parameter that no template has, a file that is not there, and neither modes nor
        responses.

    Examples
    --------
    >>> import sys, tempfile
    >>> from pathlib import Path
    >>> import calib
    >>> from calib.study.solver import solver_model
    >>> here = Path(tempfile.mkdtemp())
    >>> _ = (here / "run.py.j2").write_text("print('response,value', 'load,%r' % (2 * {{ k }}), sep=chr(10))")
    >>> model = solver_model(
    ...     ["sh", "-c", f"{sys.executable} run.py > out.csv"], template="run.py.j2", responses="out.csv", folder=here,
    ...     parameters=[calib.Parameter("k", 3.0, 1.0, 5.0)],
    ... )
    >>> model.function({"k": 3.0})
    {'load': 6.0}
    """
    place, home = "solver", path_of(folder, "folder")
    try:
        words = tuple(shlex.split(command)) if isinstance(command, str) else names(command, f"{place}, command")
    except ValueError as fault:
        raise InputError(f"{command!r} cannot be read ({fault})", place=f"{place}, command") from None
    if not words:
        raise InputError("it is empty", place=f"{place}, command", remedy='name the program, such as "ccx -i job"')
    if bool(modes) == bool(responses):
        given = "both are" if modes else "neither is"
        raise InputError(f"{given} named: modes and responses", place=place, remedy="name the file that is read")
    unit_system(units, f"{place}, units")
    space = ParameterSpace(objects(parameters, Parameter, f"{place}, parameters"))
    copied = {file.name: file for file in _found(files, home, f"{place}, files")}
    solver = Solver(
        words, _decks(_found(template, home, f"{place}, template"), space), copied, space, modes=modes, shapes=shapes,
        responses=responses, matrices=(matrices,) if isinstance(matrices, str) else tuple(matrices),
        coordinates=coordinates, damped=damped, units=units, time_limit=time_limit, node_limit=node_limit, folder=home,
    )  # fmt: skip
    label = name or Path(words[0]).name
    if responses:
        return FunctionModel(label, space, solver, identity=solver.identity)
    if not len(sensors):
        raise InputError(
            "there are no motions by which its modes are followed", place=place,
            remedy='measure shapes, or name nodes of the deck: sensors = ["12z", "30z"]',
        )  # fmt: skip
    model = ModalFunctionModel(
        label, space, solver, tuple(sensors), n_modes, damped, step, sensor_tolerance=node_limit, one_sided=True
    )
    known = replace(solver, sensors=model.sensors)
    return replace(model, function=known, identity=known.identity)


def _found(given: str | Path | Sequence[str | Path], folder: Path, place: str) -> list[Path]:
    """Paths below a folder; InputError for a file that is not there or two of one name."""
    listed: Iterable[str | Path] = (given,) if isinstance(given, str | Path) else given
    files = [folder / path_of(one, place) for one in listed]
    for k, file in enumerate(files):
        if not file.is_file():
            raise InputError(f"there is no file {str(file)!r}", place=place, remedy="correct the path")
        if deck_name(file) in map(deck_name, files[:k]):
            raise InputError(f"two files are named {deck_name(file)}", place=place, remedy="rename one of them")
    return files


def _decks(files: Sequence[Path], space: ParameterSpace) -> dict[str, str]:
    """Texts of templates by the name of their decks; InputError for what is wrong in them."""
    if not files:
        raise InputError("none is named", place="solver, template", remedy="name the deck that the command solves")
    out, used = dict[str, str](), set[str]()
    for file in files:
        out[deck_name(file)], own = read_template(file, space.names)
        used |= own
    for parameter in space.names:
        if parameter not in used:
            raise InputError(
                f"no template has the parameter {parameter!r}", place=files[0],
                remedy=f"write {{{{ {parameter} }}}} where its value belongs",
            )  # fmt: skip
    return out
