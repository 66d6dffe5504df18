"""The list of tables and columns of the documents, and what a results folder has beside it."""

import csv
import json
import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
OF_RESPONSES = {"test", "response", "value", "std", "std_used", "measured", "model", "error", "error_in_std"}
OF_FRFS = {"reference", "quantity", "lines", "freq_min", "freq_max", "unit", "frac", "amplitude", "in_std"}


def documented() -> dict[str, list[str]]:
    """Columns of every table, or keys of a JSON file, by the name of the file."""
    registry = tomllib.loads((ROOT / "docs/tables.toml").read_text("utf-8"))
    out = {}
    for one in (one for group in registry["group"] for one in group["table"]):
        columns = [*one.get("common", ()), *one.get("columns", {})]
        assert all(registry["common"][name] for name in one.get("common", ()))
        for file in one["file"].split(", "):
            assert file not in out, file
            out[file] = columns
    return out


def common(name: str) -> str:
    """Meaning of a column that several tables have."""
    registry = tomllib.loads((ROOT / "docs/tables.toml").read_text("utf-8"))
    return str(registry["common"][name])


def found(file: Path) -> list[str]:
    """Columns of a table, or keys of a JSON file."""
    if file.suffix == ".json":
        return list(json.loads(file.read_text("utf-8")))
    with file.open(encoding="utf-8", newline="") as text:
        return next(csv.reader(text))


def unknown(file: Path, columns: list[str]) -> list[str]:
    """Columns of a file that are not documented; one in angle brackets stands for any that fits around them."""
    patterns = [re.compile(re.sub(r"<[^>]*>", ".+", name)) for name in columns if "<" in name]
    return [name for name in found(file) if name not in columns and not any(p.fullmatch(name) for p in patterns)]


def missing(results: Path) -> dict[str, list[str]]:
    """Files without a documented name, and columns that are not documented."""
    known, out, files = documented(), {}, sorted([*results.rglob("*.csv"), *results.rglob("*.json")])
    assert files
    for file in files:
        columns = unknown(file, known[file.name]) if file.name in known else ["not documented at all"]
        if columns:
            out[file.name] = columns
    return out


def stale(results: Path) -> dict[str, list[str]]:
    """Documented columns that tables of modes do not have; those of other measurements and of several tests apart."""
    known, out = documented(), {}
    for file in (file for file in results.rglob("*.csv") if file.name in known):
        apart = OF_RESPONSES | OF_FRFS if file.name.startswith(("measured", "comparison")) else {"test"}
        apart |= {"freq"} if file.name == "why.csv" else set()
        columns = {name for name in known[file.name] if "<" not in name} - apart - set(found(file))
        if columns:
            out[file.name] = sorted(columns)
    return out
