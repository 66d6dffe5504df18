"""The folder of an imported model: its matrices, the code that makes the model of them, and its study."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from string import Template
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
import scipy.sparse as sp

from calib.errors.arguments import path as path_of
from calib.errors.errors import InputError
from calib.imports.matrices import Kind, ReadMatrices
from calib.measurement.files.read import Named, found_files, read_modes
from calib.measurement.modal import MeasuredModes
from calib.problem.parameter import Parameter
from calib.results.written import write_new_folder
from calib.structure.matrices import Scaling
from calib.structure.model import StructuralModel

TEMPLATE = resources.files("calib") / "template"
TermsByKind: TypeAlias = Mapping[Kind, Mapping[str, tuple[Any, Scaling]]]
"""Matrices of each kind by name, each with the parameters that multiply it."""


def model_of(
    read: ReadMatrices, terms: TermsByKind, parameters: Sequence[Parameter], units: str, name: str
) -> StructuralModel:
    """The model of matrices that were read, with its parameters."""
    return StructuralModel.from_matrices(
        terms["stiffness"], terms["mass"], terms["damping"], dofs=read.dofs, parameters=parameters, units=units,
        layers=read.layers, lines=read.lines, sets=read.sets, name=name,
    )  # fmt: skip


def write_study(
    model: StructuralModel, read: ReadMatrices, units: str, terms: TermsByKind, source: str, folder: Path, study: str,
    more: Mapping[str, bytes],
) -> Path:  # fmt: skip
    """Write the study of an imported model; returns its folder.

    Parameters
    ----------
    model : StructuralModel
    read : ReadMatrices
        Rows, lines and sets.
    units : str
        Unit system of the matrices.
    terms : mapping from kind to mapping from name to (matrix, scaling)
    source : str
        Where the matrices come from, in words.
    folder : Path
        One that does not exist yet.
    study : str
        Text of its ``study.toml``.
    more : mapping from name to bytes
        Further files.
    """
    scalings = {
        kind: "{" + "".join(f"\n    {json.dumps(n)}: {json.dumps(by)}," for n, (_, by) in own.items()) + "\n}"
        for kind, own in terms.items()
    }
    code = Template((TEMPLATE / "imported_model.py.txt").read_text("utf-8")).substitute(
        source=_plain(source), units=units, **scalings,
        parameters="".join(f"    {_parameter_text(p)},\n" for p in model.space.parameters),
        layers="None" if read.layers is None else toml_text(read.layers), name=_plain(model.name),
    )  # fmt: skip
    held: dict[str, Any] = {}
    for kind, own in terms.items():
        for name, (one, _) in own.items():
            coo = sp.coo_array(one)
            held |= {f"{kind} {name} entries": coo.data, f"{kind} {name} rows": coo.row.astype(np.int32),
                     f"{kind} {name} columns": coo.col.astype(np.int32)}  # fmt: skip
    packed = io.BytesIO()
    np.savez_compressed(packed, **held)
    contents = {
        **more, "study.toml": study.encode(), "model.py": code.encode(), "matrices.npz": packed.getvalue(),
        "dofs.csv": read.dofs.to_csv(index=False).encode(),
        "lines.csv": pd.DataFrame(read.lines, columns=["node", "to_node"]).to_csv(index=False).encode(),
        "sets.csv": _sets_table(read).to_csv(index=False).encode(),
    }  # fmt: skip
    write_new_folder(folder, contents)
    return folder


def _sets_table(read: ReadMatrices) -> pd.DataFrame:
    """Set and node, one row each."""
    return pd.DataFrame([(name, node) for name, own in read.sets.items() for node in own], columns=["set", "node"])


def _parameter_text(p: Parameter) -> str:
    """The call that makes a parameter."""
    prior = "" if p.prior_sd is None else f", prior_sd={p.prior_sd!r}"
    prior += ', distribution="fixed"' if p.distribution == "fixed" else ""
    return f"Parameter({toml_text(p.name)}, {p.value!r}, {p.lower!r}, {p.upper!r}, {toml_text(p.unit)}{prior})"


def measurement_of(
    measured: Named, shapes: Named, sensors: str | Path | None, contents: dict[str, bytes]
) -> tuple[list[str], MeasuredModes | None]:
    """Lines of ``[measurement]``, whose files are added to the study's, and what was measured."""
    if not measured and (shapes or sensors):
        raise InputError("no modes are named beside shapes and places", place="measured", remedy="name them")
    if not measured:
        return [
            '# files = ["modes.csv"]                # measured modes: put the file here and take the # away',
            '# shapes = ["shapes.csv"]              # with shapes in a table',
            '# sensors = "sensors.csv"              # with nodes that are numbered otherwise: node, x, y, z (m)',
        ], None
    named = {"files": found_files(measured), "shapes": found_files(shapes) if shapes else []}
    named["sensors"] = [path_of(sensors, "sensors")] if sensors is not None else []
    read = read_modes(named["files"], shapes=named["shapes"], sensors=sensors)
    out: dict[str, list[str]] = {}
    for key, files in named.items():
        for file in files:
            name = file.name if file.name not in contents else f"{len(contents)}_{file.name}"
            contents[name] = file.read_bytes()
            out.setdefault(key, []).append(name)
    lines = [f"{key} = [{', '.join(map(toml_text, out[key]))}]" for key in ("files", "shapes") if key in out]
    lines += [f"sensors = {toml_text(out['sensors'][0])}"] if "sensors" in out else []
    return lines, read


def toml_text(text: str) -> str:
    """Text in quotes, as TOML and Python read it."""
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def _plain(text: str) -> str:
    return re.sub(r'[\\"$]', "_", text)
