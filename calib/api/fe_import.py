"""Matrices that a finite-element code has written become a model, checked, and a study in a folder."""

from __future__ import annotations

import re
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from string import Template
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
import scipy.sparse as sp

from calib.api.display import Displayed
from calib.api.entries.entry import Entry, Rows, Warned, Words, count, decimals
from calib.api.fe_agreement import against
from calib.api.fe_study import TEMPLATE, TermsByKind, measurement_of, model_of, toml_text, write_study
from calib.errors.arguments import path as path_of
from calib.errors.errors import EvaluationError, InputError
from calib.imports.fe_modes import read_fe_modes
from calib.imports.matrices import KINDS, ReadMatrices, read_matrices
from calib.measurement.files.read import UFF_SUFFIXES, Named, found_files
from calib.measurement.files.uff_blocks import read_blocks
from calib.measurement.frf_units import LENGTHS
from calib.measurement.modal import DIRECTIONS, MeasuredModes
from calib.problem.space import Parameter
from calib.structure.located import sensor_partners
from calib.structure.model import StructuralModel
from calib.structure.modes import Modes
from calib.structure.unit_system import SYSTEMS, unit_system
from calib.study.study_file import shell_argument, study_file

Names: TypeAlias = str | Sequence[str]

MODES = 10
"""Modes that an import computes."""
_BEYOND = 4
"""Further modes of the model, so that the last ones of the code have those that are as low as they beside them."""
_ALIKE = 0.01
"""Relative difference of the mass that moves in two directions that is worth a word."""
_LOOSE, _LOOSE_SHARE = 6, 0.01
"""Rows with mass and without stiffness that a model may have, such as those of a free mass: so many, or this share."""
_NOTHING, _MOST = 1e-6, 0.5
"""Sum of a row of the mass over that of its moduli that is none, and the share of such rows that is told."""
_PARAMETER = "stiffness"


@dataclass(frozen=True, eq=False, repr=False)
class Imported(Displayed):
    """An imported model, with what was found at the door.

    Attributes
    ----------
    model : StructuralModel
        With a factor of 1 on each stiffness matrix as its parameter.
    read : ReadMatrices
        In the code's own units.
    modes : DataFrame
        ``mode, freq`` (Hz), and where the code's own modes were given ``code_freq`` (Hz), ``freq_error`` (relative) and
        ``mac``. With element sets also ``set``, that of the largest share of the strain energy at its nodes, and
        ``energy_share``.
    notes, warnings : tuple of str
        What was found, and what is to be checked.
    units : str
        Unit system of ``read``.
    study : Path or None
        Folder of the study that was written.
    measured : bool
        Whether the study has a measurement.
    at : str
        Values of the parameters at ``modes``, such as ``E = 2e+11``; empty for the nominal ones.
    """

    model: StructuralModel
    read: ReadMatrices
    modes: pd.DataFrame
    notes: tuple[str, ...]
    warnings: tuple[str, ...] = ()
    units: str = "m-kg-N"
    study: Path | None = None
    measured: bool = False
    at: str = ""

    @property
    def sentences(self) -> tuple[str, ...]:
        """What is to be checked, then what was found."""
        return (*self.warnings, *self.notes)

    @property
    def table(self) -> pd.DataFrame:
        """The first modes."""
        return self.modes

    @property
    def entries(self) -> tuple[Entry, ...]:
        """What the command prints."""
        known = "code_freq" in self.modes
        heads: tuple[str, ...] = ("mode", "Hz", "Hz of the code", "difference", "MAC") if known else ("mode", "Hz")
        heads += ("strain energy, most in",) if "set" in self.modes else ()
        rows = [
            (str(row["mode"]), f"{row['freq']:.6g}", *(_beside(row) if known else ()))
            + ((f"{row['set']} ({row['energy_share']:.0%})",) if "set" in row else ())
            for row in self.modes.to_dict("records")
        ]
        at = f" at the fresh point {self.at}" if self.at else ""
        title = f"{self.model.n_dof} degrees of freedom. First modes of the imported model{at}:"
        told: list[Entry] = [
            *(Warned(words) for words in self.warnings),
            *(Words(words, "always") for words in self.notes),
        ]
        return (*told, Rows.of(title, heads, rows, most=len(rows)))

    @property
    def next_steps(self) -> tuple[str, ...]:
        """What to do with the study that was written; empty without one."""
        if self.study is None:
            return ()
        folder = shell_argument(self.study)
        if self.measured:
            return (f"Written: {self.study}", f"Compare it with the measurement: calib compare {folder}")
        return (
            f"Written: {self.study}",
            f"Add what was measured to [measurement] of {self.study / 'study.toml'}, then: calib compare {folder}",
        )

    def __repr__(self) -> str:
        return f"Imported({self.model.n_dof} degrees of freedom, {count(len(self.modes), 'mode')})"


def import_matrices(
    files: Named,
    *,
    dofs: str | Path | None = None,
    coordinates: str | Path | None = None,
    units: str | None = None,
    stiffness: Names = (),
    mass: Names = (),
    damping: Names = (),
    modes: str | Path | None = None,
    modes_shapes: str | Path | None = None,
    measured: Named = (),
    shapes: Named = (),
    sensors: str | Path | None = None,
    to: str | Path | None = None,
) -> Imported:
    """Take the matrices of a finite-element code over as a model, and write a study of it.

    Read are CalculiX (.sti, with .mas, .dof and .inp beside it), Abaqus (.mtx), Nastran (DMIG punch, OUTPUT4, .op2),
    ANSYS (Harwell-Boeing with mapping), Matrix Market, MATLAB's .mat and .npz.

    Parameters
    ----------
    files : path or sequence of paths
        Of the matrices; decks among them give coordinates, mappings and .dof files the names of rows. Or the folder of
        a study whose model is a solver: its matrices over its parameters are found by runs, and checked by others.
    dofs : path, optional
        Node and direction of each row where no file of the code names them: a table ``node, direction[, x, y, z]`` in
        the code's unit of length, two columns, or numbers such as 12.3.
    coordinates : path, optional
        A table ``node, x, y, z`` in m, or a deck with ``*NODE`` or ``GRID``.
    units : {"m-kg-N", "mm-t-N", "mm-kg-mN", "in-lbf", "in-kip", "ft-lbf"}, optional
        Of the matrices and the deck; by default m-kg-N, which is told with the mass in the others.
    stiffness, mass, damping : str or sequence of str, optional
        Of matrices or their files, where these do not tell what they are. Each stiffness matrix gets a parameter.
    modes : path, optional
        What the code itself computed; see `calib.compare_modes`.
    modes_shapes : path, optional
        Shapes table beside a table of these modes.
    measured, shapes, sensors : path or sequence of paths, optional
        Measured modes, shapes and places of measured nodes for the study, as `calib.read_modes` takes them.
    to : path, optional
        A folder that does not exist yet, for the study.

    Returns
    -------
    Imported
        ``model``, the table ``modes``, and what was found in words.

    Raises
    ------
    InputError
        For files that cannot be read, rows without names or named twice, matrices of other sizes, entries that are not
        finite, asymmetry, and modes that cannot be solved.

    Examples
    --------
    A mass of 4 kg between two springs and one of 2 kg on it:

    >>> import tempfile
    >>> from pathlib import Path
    >>> import numpy as np
    >>> import calib
    >>> file = Path(tempfile.mkdtemp()) / "chain.npz"
    >>> np.savez(file, K=1e4 * np.array([[2, -1], [-1, 1]]), M=np.diag([4.0, 2.0]), dofs=[[1, 3], [2, 3]])
    >>> calib.import_matrices(file).modes["freq"].round(2).tolist()
    [6.09, 14.7]
    """
    named = found_files(files)
    if len(named) == 1 and study_file(named[0]).is_file() and (named[0].is_dir() or named[0].suffix == ".toml"):
        from calib.api.fe_runs import import_runs

        given = (dofs, coordinates, units, stiffness, mass, damping, modes, modes_shapes, measured, shapes, sensors)
        if any(given):
            raise InputError("a study has all that its import needs", place="calib import", remedy="give --to alone")
        return import_runs(study_file(named[0]), None if to is None else path_of(to, "to"))
    system = unit_system(units or "m-kg-N", "units")
    chosen = {kind: (names,) if isinstance(names, str) else tuple(names)
              for kind, names in (("stiffness", stiffness), ("mass", mass), ("damping", damping))}  # fmt: skip
    read = read_matrices(
        named, dofs=None if dofs is None else path_of(dofs, "dofs"), metres=system.length, chosen=chosen,
        coordinates=None if coordinates is None else path_of(coordinates, "coordinates"),
    )  # fmt: skip
    factors = _factors(list(read.matrices["stiffness"]))
    terms: TermsByKind = {
        kind: {name: (one, factors[name] if kind == "stiffness" else {}) for name, one in read.matrices[kind].items()}
        for kind in KINDS
    }
    parameters = [Parameter(name, 1.0, 0.5, 1.5, "-", prior_sd=0.1) for name in factors.values()]
    model = model_of(read, terms, parameters, system.name, named[0].stem)
    _require_stiffness(model)
    notes, warnings = _weighed(model, units)
    halves = [a.item for a in model.assumptions if a.value == "symmetric"]
    mirrored = (f"One triangle was given and has been mirrored: {', '.join(halves)}.",) if halves else ()
    fixed = tuple(f"{a.item}: {a.reason}." for a in model.assumptions if a.value != "symmetric")
    notes = (*read.notes, *mirrored, *fixed, *notes)
    found, table, told = _solved(model, read)
    notes += told
    if modes is not None:
        own = read_fe_modes(
            file := path_of(modes, "modes"), length_unit=_length_unit(file, system.length),
            shapes=None if modes_shapes is None else path_of(modes_shapes, "modes_shapes"),
        )  # fmt: skip
        table, told, doubts = against(model, own, found, table)
        notes, warnings = (*notes, *told), (*warnings, *doubts)
        if doubts and any(words.startswith("common null space") for words in fixed):
            warnings += (
                "For motions without stiffness and mass, which are fixed here, codes print modes that are none.",
            )
    out = Imported(model, read, table, notes, warnings, system.name)
    if to is None:
        return out
    contents: dict[str, bytes] = {}
    lines, seen = measurement_of(measured, shapes, sensors, contents)
    if seen is not None:
        out = replace(out, warnings=(*warnings, *_misplaced(model, seen)))
    text = Template((TEMPLATE / "imported_study.toml").read_text("utf-8")).substitute(
        title=toml_text(f"Imported model {model.name}"), measurement="\n".join(lines),
        mode_count=min(model.n_dof, max(MODES, 0 if seen is None else 2 * seen.n_modes)),
    )  # fmt: skip
    source, new = ", ".join(file.name for file in named), path_of(to, "to")
    folder = write_study(model, read, system.name, terms, source, new, text, contents)
    return replace(out, study=folder, measured=bool(measured))


def _misplaced(model: StructuralModel, seen: MeasuredModes) -> tuple[str, ...]:
    """Why a comparison of the study will be refused, or will take numbers of nodes for their places."""
    partners = sensor_partners(model, seen.sensors)
    if partners is not None:
        try:
            partners.require(model.name)
        except InputError as fault:
            return (f"The study will not compare: {fault}",)
    if seen.has_shapes and all(s.point is None for s in seen.sensors):
        return ("No place of a measured node is known (--sensors): they are taken as the nodes of their numbers.",)
    return ()


def _beside(row: Mapping[Hashable, Any]) -> tuple[str, ...]:
    """Cells of the code's own mode; empty where it has none."""
    if not np.isfinite(row["code_freq"]):
        return "", "", ""
    return f"{row['code_freq']:.6g}", f"{row['freq_error']:.1e}", decimals(row["mac"], 5)


def _factors(names: Sequence[str]) -> dict[str, str]:
    """Parameter of each stiffness matrix."""
    if len(names) == 1:
        return {names[0]: _PARAMETER}
    return {name: re.sub(r"\W", "_", name) for name in names}


def _require_stiffness(model: StructuralModel) -> None:
    """InputError where many rows have mass and no stiffness: each would be a motion of 0 Hz."""
    values = model.space.si(model.space.values)
    stiff, inert = (abs(sp.csr_array(one)).sum(axis=1) for one in (model.stiffness(values), model.mass(values)))
    loose = np.flatnonzero((stiff == 0) & (inert > 0))
    if len(loose) > max(_LOOSE, _LOOSE_SHARE * model.n_dof):
        raise InputError(
            f"{len(loose)} of {model.n_dof} rows have mass and no stiffness, such as {_row_words(model, loose[0])}",
            place=f"model {model.name}", remedy="is the file of the stiffness cut off, or of another model?",
        )  # fmt: skip


def _row_words(model: StructuralModel, k: int) -> str:
    node, direction = model.dofs.node[k], DIRECTIONS[model.dofs.direction[k]]
    return f"row {k + 1}" + (f" (node {model.labels[node]}, {direction})" if node >= 0 else "")


def _weighed(model: StructuralModel, units: str | None) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The mass that moves in each direction, and what is odd in it; InputError for a mass that is a stiffness."""
    inertia = sp.csr_array(model.mass(model.space.si(model.space.values)))
    moving = []
    for k in range(3):
        rigid = ((model.dofs.direction == k) & (model.dofs.node >= 0)).astype(float)
        moving.append(float(rigid @ (inertia @ rigid)))
    axes = [axis for axis, kg in zip("xyz", moving, strict=True) if kg != 0]
    if not axes:
        return (), ("No row of a translation has mass: check which matrix is the mass.",)
    listed = ", ".join(f"{kg:.5g}" for kg in moving if kg != 0)
    words = f"Mass that moves in {', '.join(axes)}: {listed} kg, without supported rows. Compare it with the weight."
    warnings = []
    known = [kg for kg in moving if kg != 0]
    if min(known) < 0:
        warnings.append("The mass that moves in a direction is negative: check the sign of the mass matrix.")
    elif max(known) > (1 + _ALIKE) * min(known):
        words += " It differs with the direction where supports, or rows of the code's own, take a part."
    if units is None:
        others = ", ".join(f"{max(known) * s.mass:.4g} kg in {name}" for name, s in SYSTEMS.items() if name != "m-kg-N")
        words += f" No unit system is stated, and m-kg-N is taken; it would be {others}."
    total, moved = abs(inertia), np.zeros((2, model.n_dof))
    for k in range(3):
        rigid = ((model.dofs.direction == k) & (model.dofs.node >= 0)).astype(float)
        moved += np.where(rigid > 0, [np.abs(inertia @ rigid), total @ rigid], 0.0)
    heavy = moved[1] > 0
    if np.mean(moved[0][heavy] < _NOTHING * moved[1][heavy]) > _MOST:
        raise InputError(
            "most rows of the mass resist no translation, as rows of a stiffness do", place=f"model {model.name}",
            remedy="stiffness and mass are exchanged, or the mass is a stiffness: name them, --stiffness and --mass",
        )  # fmt: skip
    bare = int((inertia.diagonal() == 0).sum())
    notes = [words]
    if bare:
        notes.append(f"{bare} of {model.n_dof} rows have no mass on the diagonal, as rotations and midside nodes may.")
    return tuple(notes), tuple(warnings)


def _length_unit(file: Path, metres: float) -> str | None:
    """The code's unit of length by its name; None for a universal file that states its own (dataset 164)."""
    if file.suffix.lower() in UFF_SUFFIXES and file.is_file() and any(b.kind == 164 for b in read_blocks(file, [])):
        return None
    return next(unit for unit, own in LENGTHS.items() if own == metres)


def _solved(model: StructuralModel, read: ReadMatrices) -> tuple[Modes, pd.DataFrame, tuple[str, ...]]:
    """Modes of the model, the first with the element set of most strain energy, and how many rigid-body motions."""
    try:
        found = model.modes({}, min(MODES + _BEYOND, model.n_dof))
    except EvaluationError as fault:
        diagonal = model.stiffness(model.space.si(model.space.values)).diagonal()
        words, remedy = str(fault), "do stiffness, mass and rows belong to one run, and is the mass the mass?"
        if (diagonal < 0).any():
            k = int(np.argmin(diagonal))
            words = f"the stiffness at {_row_words(model, k)} is {diagonal[k]:.4g}"
            remedy = "correct the sign of the stiffness matrix"
        raise InputError(f"its modes cannot be solved ({words})", place=f"model {model.name}", remedy=remedy) from None
    freq = np.asarray(found.natural_freq)[:MODES]
    rigid = sum(one.kind == "zero" for one in found.excluded)
    notes = (f"{count(rigid, 'rigid-body motion')}: the model is free.",) if rigid else ()
    table = pd.DataFrame({"mode": np.arange(1, len(freq) + 1), "freq": freq})
    every = len(read.dofs["node"].dropna().unique())
    sets = [name for name, nodes in read.sets.items() if len(nodes) < every]
    if sets:
        shares = model.energy_shares({}, found.shapes[:, : len(freq)], sets)
        table["set"] = [sets[k] for k in shares.argmax(axis=0)]
        table["energy_share"] = shares.max(axis=0)
    return found, table, notes
