"""What the README and the pages state in numbers of two studies, written from the results of these studies.

A quick search ends at the same least-squares solution as a full one, so that both agree to every digit that is stated.
"""

import json
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd

ROOT = Path(__file__).resolve().parents[2]
IN_WORDS = {5: "five", 8: "eightfold"}
Statement = tuple[str, str]
"""A page and its words."""


def unstated(results: Path) -> list[Statement]:
    """Statements that these results make, and that do not stand in their page."""
    made = [*of_the_calibrations(results), *of_the_explanation(results / "hidden_bogie"), *of_the_rig(results)]
    return [(page, words) for page, words in made if words not in plain(ROOT / page)]


def plain(page: Path) -> str:
    """The text of a page in one line, without marks and targets of links."""
    text = re.sub(r"\]\([^)]*\)", "", page.read_text("utf-8"))
    return " ".join(re.sub(r"[*`\[]", "", text).split())


def read(file: Path, *index: str) -> pd.DataFrame:
    return pd.read_csv(file).set_index(list(index))


def of_the_calibrations(results: Path) -> Iterator[Statement]:
    """`calib calibrate` of the hidden bogie."""
    base = results / "hidden_bogie/quick"
    summary = json.loads((base / "summary.json").read_text("utf-8"))
    yield "docs/tutorial.md", f"{100 * summary['mean_freq_error_before']:.1f} % off on average"
    yield "docs/tutorial.md", f"mean MAC is {summary['mean_mac_before']:.3f}, where"
    yield "docs/tutorial.md", f"noise alone would leave {summary['noise_mac']:.3f}"
    yield "docs/tutorial.md", f"frequency error falls to {100 * summary['mean_freq_error_after']:.1f} %"
    yield "docs/tutorial.md", f"mean MAC rises to {summary['mean_mac_after']:.3f}"
    squares = f"{summary['whitened_misfit']:.0f} for {summary['degrees_of_freedom']:.0f} degrees of freedom"
    yield "docs/tutorial.md", squares
    yield "docs/decision.md", squares


def of_the_explanation(folder: Path) -> Iterator[Statement]:
    """`calib compare` and `calib explain` of the hidden bogie."""
    found = json.loads((folder / "explanation.json").read_text("utf-8"))
    wrong = read(folder / "where_it_fails_before.csv", "kind", "what").loc[("frequency", "2BT")]
    yield "docs/tutorial.md", f"2BT by {100 * wrong['value']:.0f} %, which is {wrong['in_std']:.0f} standard deviations"
    wood = read(folder / "pulls.csv", "model", "parameter").loc[("base", "E_wood")]
    yield "docs/tutorial.md", f"{100 * (wood['value'] / wood['nominal'] - 1):.0f} % stiffer"
    yield (
        "docs/tutorial.md",
        f"of {wood['standardised']:.1f} times its expected deviation where chance allows {wood['limit']:.1f}",
    )

    effects, n_local = read(folder / "effects.csv", "name"), found["local_perturbations"]
    unit, mass = effects.loc["brake_unit"], effects.loc["crossbar_mass"]
    size, low, high = unit[["magnitude", "magnitude_low", "magnitude_high"]]
    hidden = json.loads((ROOT / "tests/truth/hidden_bogie.json").read_text("utf-8"))["magnitudes"]["brake_unit"]
    told = json.loads((folder / "record.json").read_text("utf-8"))["analyses"]["explain"]["answer"]
    yield "README.md", told["found"]
    yield "README.md", told["then"]
    yield "README.md", told["sure"][told["sure"].index("A cause that is not listed") :]
    yield "README.md", f"hidden brake unit of {hidden:.1f} kg"
    least = float(f"{unit['magnitude_min']:.2g}")
    scores = unit["z"] / size * np.array([size, least])
    yield "README.md", f"{scores[0]:.0f} for {size:.0f} kg, {scores[1]:.0f} for the {least:g} kg that just show"
    yield "docs/tutorial.md", f"{size:.1f} kg (95 % interval {low:.1f} to {high:.1f} kg)"
    yield "docs/tutorial.md", f"weighs {hidden:.1f} kg"
    yield "docs/studies.md", f"a brake unit of {hidden:.1f} kg"
    yield "docs/studies.md", f"effect: {size:.1f} kg (95 %: {low:.1f} to {high:.1f} kg)"

    threshold = np.log(len(effects)) + 3
    yield "docs/tutorial.md", f"{n_local} local stiffness or mass changes"
    yield "docs/tutorial.md", f"is {unit['ln_bayes']:.0f}; the next effect has {mass['ln_bayes']:.0f}"
    yield "docs/decision.md", f"| {threshold:.1f} for {len(effects)} effects |"
    yield "docs/decision.md", f"largest score {effects['z'].abs().max():.0f}"
    yield "docs/decision.md", f"Bayes factor of {unit['ln_bayes']:.0f} (needed: {threshold:.1f})"
    yield "docs/decision.md", f"on the crossbars, {mass['ln_bayes']:.0f} and only"
    places = read(folder / "why_places.csv", "perturbation")["correlation"]
    like = places.abs().idxmax()
    yield (
        "docs/decision.md",
        f"{like.removeprefix('added ')}, whose change pattern has a correlation of {places[like]:.2f}",
    )

    left, errors = found["adequacy_p_family"], read(folder / "errors.csv", "group", "stage")
    rest = "p > 0.1" if left > 0.1 else f"p = {left:.2f}"  # samples differ with the rounding of a machine
    yield "docs/tutorial.md", f"({rest})"
    yield (
        "docs/decision.md",
        f"{rest} over {len(effects)} effects, {n_local} local stiffness or mass changes and "
        f"{found['faults']} measurement errors",
    )
    yield "docs/decision.md", f"the worst kind of data or mode shape has p = {found['adequacy_p_fit']:.3f}"
    yield "docs/decision.md", f"{errors['rows']['fit', 'before']:.0f} used values"
    for group, words in (
        ("held_out_sensors", "sensors {:.1f} → {:.1f} standard deviations ({:.1f} expected)"),
        ("held_out_modes", "modes {:.2f} → {:.2f} ({:.2f})"),
    ):
        before, (after, expected) = errors["rms"][group, "before"], errors.loc[(group, "after"), ["rms", "expected"]]
        yield "docs/decision.md", words.format(before, after, expected)

    suspects = pd.read_csv(folder / "suspects_explained.csv")
    (suspect,) = suspects[suspects["explains"]].sort_values("p").to_dict("records")[:1]
    yield "docs/tutorial.md", f"Without {suspect['what']} the model would fit as it is"

    gains = read(folder / "next_measurement.csv", "measurement", "effect")["gain"]
    own = re.search(r"computed at (\S+ Hz)", "\n".join(gains.index.get_level_values(0)))
    assert own is not None
    yield "docs/tutorial.md", f"adds a mode at {own[1]}"
    best = gains["mode 9BT, validation data so far"].max()
    yield "docs/tutorial.md", f"{IN_WORDS[int((~effects['visible']).sum())]} other effects"
    yield (
        "docs/tutorial.md",
        f"Mode 9BT, validation data so far, would raise the score of one of them {IN_WORDS[round(best)]}",
    )


def of_the_rig(results: Path) -> Iterator[Statement]:
    """`calib run` of the four-storey rig."""
    folder, page = results / "four_storey_rig/quick", "studies/four_storey_rig/README.md"
    fails = pd.read_csv(folder / "where_it_fails_before.csv")
    errors, in_std = 100 * fails["value"].abs(), f"{fails['in_std'].min():.0f} to {fails['in_std'].max():.0f}"
    factors = read(folder / "verdicts.csv", "parameter")["value"][["k1", "k2", "k3", "k4"]]
    yield page, f"{errors.min():.1f} to {errors.max():.1f} % off, {in_std} standard deviations"
    yield page, "factors of {:.3f}, {:.3f}, {:.3f} and {:.3f}".format(*factors)
    yield "docs/studies.md", f"{errors.mean():.1f} % off, {in_std} standard deviations"
    yield "docs/studies.md", "storeys of {:.2f}, {:.2f}, {:.2f} and {:.2f} times".format(*factors)
