"""Explanations of every verdict of a toy whose effects have an engineer's words, and their text."""

from dataclasses import replace

import numpy as np
import pandas as pd

from calib.missing.decision import decide
from calib.missing.local import interval_words
from calib.missing.recommendation import Recommendation
from calib.missing.tables import effects_table
from calib.missing.verdict import verdict_of as verdict_of

WORST = "the worst kind of data or mode shape"
UNITS = {"E0": "kg", "E1": "-", "E2": "kN/m", "E3": "-", "E4": "kg"}
VERDICTS = (
    "nothing_detectable", "effect", "indistinguishable", "two_effects", "several_effects", "partial",
    "none_explains",    "noise_underestimated",
)  # fmt: skip


def dressed(toy):
    """Effects as an engineer would call them, with units."""
    effects = tuple(
        replace(
            e, title=f"Title of {e.name}", phrase=f"a lack of {e.name}",
            lacks=f"No {e.name}.", look_for=f"A broken {e.name}.",
            magnitude=replace(e.magnitude, unit=UNITS.get(e.name, "kg")),
        )
        for e in toy.effects
    )  # fmt: skip
    return replace(toy, effects=effects)


def first(toy, truth, verdict, noise=1.0, seed=1):
    """The first simulated data set with a given verdict."""
    rng = np.random.default_rng(seed)
    for _ in range(40):
        found = decide(toy.drawn(rng, truth, noise))
        if found.verdict == verdict:
            return found
    raise AssertionError(f"no draw is {verdict}")


def errors(**more):
    rows = [
        ("fit", 1.4, 0.7, 0.97),
        ("left_out", 3.28, 1.16, 1.19),
        ("held_out_sensors", 1.93, 0.89, 1.04),
        ("held_out_modes", 0.97, 0.94, 1.0),
    ]
    table = [
        (g, stage, value, floor, 0.5)
        for g, b, a, floor in rows
        for stage, value in (("before", b), ("after", more.get(g, a)))
    ]
    return pd.DataFrame(table, columns=["group", "stage", "rms", "expected", "p"])


def text_of(found, intervals=None, recommendation="", some_errors=None, change=None):
    table = effects_table(found, intervals or {}, {})
    for (name, column), value in (change or {}).items():
        table.loc[table["name"] == name, column] = value
    advised = Recommendation(recommendation) if recommendation else None
    return " ".join(verdict_of(found, table, errors() if some_errors is None else some_errors, advised).sentences)


def sized(row):
    """An effect of the table with its magnitude."""
    interval = (row["magnitude_low"], row["magnitude_high"], row["unit"])
    return f"a lack of {row['name']}, {interval_words(row['magnitude'], *interval)}"


def every_verdict(toy):
    """Explanations of every verdict."""
    plain = dressed(toy(effects=5))
    partly = toy(effects=3, perturbations=6)
    hidden = 0.25 * sum(partly.columns[f"A{k}"] for k in range(6))
    partly = dressed(replace(partly, columns={**partly.columns, "hidden": hidden}))
    return {
        "nothing_detectable": first(plain, {}, "nothing_detectable"),
        "effect": first(plain, {"E2": 1.5}, "effect"),
        "indistinguishable": first(plain.correlated("E3", "E2", 0.9), {"E2": 0.9}, "indistinguishable"),
        "two_effects": first(plain, {"E0": 1.2, "E3": 1.2}, "two_effects"),
        "several_effects": first(plain, {"E0": 1.2, "E3": 1.2, "E4": 1.5}, "several_effects"),
        "partial": first(partly, {"E1": 3.0, "hidden": 2.0}, "partial"),
        "none_explains": first(plain, {"A7": 1.5}, "none_explains"),
        "noise_underestimated": first(dressed(toy(modes=12, sensors=60)), {}, "noise_underestimated", 2.0),
    }


def with_p(p):
    return f"p {chance(p)}" if p < 1 / 4000 else f"p = {chance(p)}"


def chance(p):
    return "< 0.0004" if p < 3 / 8000 else f"{p:.2g}"
