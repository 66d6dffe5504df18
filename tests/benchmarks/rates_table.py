"""Error rates from runs, each with what it is required to be and how sure that is."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

Row = dict[str, Any]

NAMING = ("effect", "indistinguishable", "two_effects", "several_effects")
"""Verdicts that name effects."""
DETECTABLE = 6.0
"""Expected score from which an effect outside the library counts as detectable, and all of several as visible."""


class Rate(NamedTuple):
    """One criterion: in ``count`` of ``n`` runs with ``hidden`` the answer was ``verdict``.

    ``required`` is the share that is required, at least or at most.
    """

    hidden: str
    verdict: str
    required: float
    at_least: bool
    count: int
    n: int


def report(rows: Sequence[Row], code: str | None, counts: Path | None = None, made: str = "") -> None:
    """Print the table and every run that went wrong; ``counts`` is a file for the counts alone, see `write`."""
    if not rows:
        print("no runs yet")
        return
    codes = Counter(row["code"] for row in rows)
    latest = rows[-1]["code"] if code is None else code
    if latest != "all":
        rows = [row for row in rows if row["code"] == latest]
    if counts is not None:
        write([row for row in rows if row["outcome"] != "failed"], counts, latest, made)
    print(f"{len(rows)} runs of code {latest}; in the file: {dict(codes)}\n")
    failed = [row for row in rows if row["outcome"] == "failed"]
    rows = [row for row in rows if row["outcome"] != "failed"]
    _rates(rows)
    report_methods(rows, methods_file(counts), made)
    _nearly(rows)
    _numbers(rows)
    _by_effect(rows)
    _exceptions(rows, failed)


def _nearly(rows: Sequence[Row]) -> None:
    """How often something like an effect is told, which names no cause, and how often that effect is there."""
    told = [row["nearly"] for row in rows if row.get("nearly")]
    right = [one for one in told if one["right"]]
    if told:
        held = sum(one["holds"] for one in right)
        print(
            f"something like an effect: {len(told)} runs, that effect is hidden in {len(right)}, range holds {held}\n"
        )


def write(rows: Sequence[Row], file: Path, code: str, made: str) -> None:
    """Write the counts as CSV, with the code and the date (ISO) of the runs; the documents are built from it."""
    write_rates(rates(rows), file, code, made)


def write_rates(found: Sequence[Rate], file: Path, code: str, made: str) -> None:
    """The same for rates already counted."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow([*Rate._fields, "code", "date"])
    table.writerows([*rate, code, made] for rate in found if rate.n)
    file.write_text(text.getvalue(), "utf-8")


def read(file: Path) -> list[tuple[Rate, str, str]]:
    """Counts as written by `write`: every rate with its code and date."""
    with file.open(encoding="utf-8", newline="") as text:
        return [(_rate_of(row), row["code"], row["date"]) for row in csv.DictReader(text)]


def read_methods(file: Path) -> list[tuple[str, Rate, str, str]]:
    """Counts of several methods as written by `report_methods`: the method, a rate of it, the codes and the date."""
    with file.open(encoding="utf-8", newline="") as text:
        return [(row["method"], _rate_of(row), row["code"], row["date"]) for row in csv.DictReader(text)]


def _rate_of(row: Mapping[str, str]) -> Rate:
    return Rate(
        row["hidden"], row["verdict"], float(row["required"]), row["at_least"] == "True",
        int(row["count"]), int(row["n"]),
    )  # fmt: skip


METHODS = ("method", *Rate._fields, "code", "methods_code", "date")
"""Columns of the file of `report_methods`."""


def report_methods(rows: Sequence[Row], counts: Path | None = None, made: str = "") -> None:
    """Print what other methods answered to the same measurements, beside the search; ``counts`` is a CSV of it.

    Rows have an entry ``methods`` of `other_methods.answers`; those of the latest code of the methods count, and all
    methods are scored by the same rule.
    """
    rows = [row for row in rows if "methods" in row]
    rows = [row for row in rows if row["methods_code"] == rows[-1]["methods_code"]]
    if not rows:
        return
    found = of_methods(rows)
    titles = list(dict.fromkeys((rate.hidden, rate.verdict) for own in found.values() for rate in own if rate.n))
    print(f"\nother methods on the same measurements ({len(rows)} runs); in brackets the one-sided 95 % bound:")
    for number, (hidden, verdict) in enumerate(titles, 1):
        print(f"  ({number}) {hidden}: {verdict}")
    print(f"{'method':22s}" + "".join(f"{f'({k})':>22s}" for k in range(1, len(titles) + 1)))
    for method, own in found.items():
        cells = {(r.hidden, r.verdict): f"{r.count} of {r.n} ({100 * bound_of(r):.1f} %)" for r in own if r.n}
        print(f"{method:22s}" + "".join(f"{cells.get(title, '-'):>22s}" for title in titles))
    if counts is not None:
        text = io.StringIO()
        table = csv.writer(text, lineterminator="\n")
        table.writerow(METHODS)
        code, own_code = codes(rows), rows[-1]["methods_code"]
        table.writerows([m, *rate, code, own_code, made] for m, own in found.items() for rate in own if rate.n)
        counts.write_text(text.getvalue(), "utf-8")


def codes(rows: Sequence[Row]) -> str:
    """Every code that some rows were made with."""
    return " ".join(dict.fromkeys(str(row["code"]) for row in rows))


def methods_file(counts: Path | None) -> Path | None:
    """Where the counts of other methods stand beside those of the search: docs/rates_bogie_methods.csv."""
    return counts and counts.with_name(f"{counts.stem}_methods{counts.suffix}")


def of_methods(rows: Sequence[Row]) -> dict[str, list[Rate]]:
    """Rates by method: rightly named of what is visible, wrong names, false alarms, and names outside the library."""
    wanted = {
        (f"one effect, expected score {DETECTABLE:g} or more", "names it rightly"),
        ("one effect of any magnitude", "names a wrong effect"),
        ("nothing", "says that something is missing"),
        ("nothing", "names something"),
        ("something that is not on the list", "names something"),
        ("a measurement error", "names a wrong effect"),
    }
    out = {}
    for method in dict.fromkeys(name for row in rows for name in row["methods"]):
        told = [row | row["methods"][method] for row in rows if method in row["methods"]]
        out[method] = [rate for rate in rates(told) if (rate.hidden, rate.verdict) in wanted]
    return out


def named(row: Row) -> bool:
    """Whether an effect was named."""
    return row["verdict"] in NAMING


def wrong(row: Row) -> bool:
    """Whether something was named that is not there."""
    return row["outcome"] in ("wrong", "extra", "mixed")


def score(row: Row) -> float:
    """Expected score of what is hidden, of the least visible one of several.

    It is the length of the change of the data that the parameters cannot absorb, at the true parameters and without
    noise. For small effects that is the fingerprint's length times the magnitude; effects that saturate change the data
    by much less than their fingerprint at magnitude 0 promises, and no test can see more than the change.
    """
    return float(min(row["visible"], default=0.0))


def rates(rows: Sequence[Row]) -> list[Rate]:
    """All criteria that are rates."""

    def group(*names: str) -> list[Row]:
        return [row for row in rows if row["group"] in names]

    def rate(
        hidden: str, verdict: str, required: float, at_least: bool, some: Sequence[Row], is_so: Callable[[Row], bool]
    ) -> Rate:
        return Rate(hidden, verdict, required, at_least, sum(map(is_so, some)), len(some))

    single = group("single")
    strong = [r for r in single if score(r) >= 6]
    middle = [r for r in single if 4 <= score(r) < 6]
    told = [r for r in single if score(r) >= 4 and named(r)]
    outside = group("outside", "removed")
    seen = [r for r in outside if score(r) >= DETECTABLE]
    nothing, noise = group("nothing"), group("noise")
    pairs, triples = group("pair"), group("triple")
    covering = [r for r in single if "covers" in r]
    both = [r for r in pairs if score(r) >= DETECTABLE]
    all_three = [r for r in triples if score(r) >= DETECTABLE]

    def right(r: Row) -> bool:
        return r["outcome"] == "right"

    def none(r: Row) -> bool:
        return r["verdict"] in ("none_explains", "misfit_unlocated")

    def some(r: Row) -> bool:
        return r["verdict"] != "nothing_detectable"

    one, two, three, detectable = "one effect", "two effects", "three effects", f"expected score {DETECTABLE:g} or more"
    none_there, doubled = "nothing", "standard deviation understated twofold"
    outside_, names = "something that is not on the list", "names something"
    return [
        rate(f"{one}, expected score 6 or more", "names it rightly", 0.95, True, strong, right),
        rate(f"{one}, expected score 4 to 6", "names it rightly", 0.80, True, middle, right),
        rate(
            f"{one}, expected score 4 or more, something named", "the truth is among the names", 0.98, True, told,
            lambda r: r["outcome"] != "wrong",
        ),
        rate(f"{one} of any magnitude", "names a wrong effect", 0.01, False, single, wrong),
        rate(none_there, "says that something is missing", 0.03, False, nothing, some),
        rate(none_there, names, 0.01, False, nothing, named),
        rate(f"{none_there}, library of 50", "says that something is missing", 0.03, False, group("fifty"), some),
        rate(f"{none_there}, library of 50", names, 0.01, False, group("fifty"), named),
        rate(outside_, names, 0.02, False, outside, named),
        rate("a design that no effect describes", names, 0.02, False, group("outside"), named),
        rate("an effect that was taken out of the library", names, 0.02, False, group("removed"), named),
        rate(f"{outside_}, {detectable}", "says that no listed effect explains it", 0.85, True, seen, none),
        rate(
            f"{outside_}, {detectable}", "the same, or that one explains it in part", 0.85, True, seen,
            lambda r: none(r) or r["verdict"] == "partial",
        ),
        rate(f"{none_there}, {doubled}", names, 0.01, False, noise, named),
        rate(
            f"{none_there}, {doubled}", "reports systematic misfit instead of underestimated noise", 0.05, False, noise,
            lambda r: r["verdict"] not in ("nothing_detectable", "noise_underestimated"),
        ),
        rate(f"{one}, {doubled}", "names a wrong effect", 0.02, False, group("noise_effect"), wrong),
        rate(f"{two}, each of {detectable}", "names both", 0.80, True, both, right),
        rate(f"{two} of any score", "names a wrong effect", 0.02, False, pairs, wrong),
        rate(f"{three}, each of {detectable}", "names all three", 0.80, True, all_three, right),
        rate(f"{three} of any score", "names a wrong effect", 0.02, False, triples, wrong),
        rate(f"{one}, named", "its 95 % interval covers the truth", 0.90, True, covering, lambda r: bool(r["covers"])),
        rate("a measurement error", "names a wrong effect", 0.01, False, group("fault"), wrong),
        rate(
            "one wrong channel", "tells it", 0.90, True, [r for r in group("fault") if r.get("fault")],
            lambda r: r["blamed"] == [r["fault"]],
        ),
        rate(
            "nothing, a wrong channel, an effect or a design outside", "is told rightly", 0.83, True,
            [r for r in rows if "told_rightly" in r], lambda r: bool(r["told_rightly"]),
        ),
    ]  # fmt: skip


def _rates(rows: Sequence[Row]) -> None:
    print(f"{'criterion':106s} {'required':>9s} {'measured':>9s} {'n':>5s} {'95 % bound':>10s} {'p':>6s}  judgement")
    for r in rates(rows):
        sign, title = ">=" if r.at_least else "<=", f"{r.hidden}: {r.verdict}"
        if not r.n:
            print(f"{title:106s} {sign} {100 * r.required:4.0f} % {'-':>9s} {0:5d}")
            continue
        bound, p = bound_of(r), chance_of(r)
        shown = bound >= r.required if r.at_least else bound <= r.required
        words = "shown" if shown else "refuted" if p < 0.05 else "survives"
        measured = f"{100 * r.count / r.n:.1f} %"
        print(
            f"{title:106s} {sign} {100 * r.required:4.0f} % {measured:>9s} {r.n:5d} {100 * bound:8.1f} % {p:6.3f}  "
            f"{words}"
        )


def bound_of(rate: Rate) -> float:
    """What the true share is at least, or at most, with 95 % confidence (Clopper and Pearson 1934, one-sided)."""
    x, n = rate.count, rate.n
    if rate.at_least:
        return 0.0 if x == 0 else float(stats.beta.ppf(0.05, x, n - x + 1))
    return 1.0 if x == n else float(stats.beta.ppf(0.95, x + 1, n - x))


def chance_of(rate: Rate) -> float:
    """Chance of a count as bad or worse when the share just meets the requirement."""
    if rate.at_least:
        return float(stats.binom.cdf(rate.count, rate.n, rate.required))
    return float(stats.binom.sf(rate.count - 1, rate.n, rate.required))


def _numbers(rows: Sequence[Row]) -> None:
    ratios = [
        r["magnitude_over_true"]
        for r in rows
        if r["group"] == "single" and "magnitude_over_true" in r and score(r) >= 4
    ]
    null = [r for r in rows if r["group"] == "nothing"]
    print()
    if ratios:
        print(f"magnitude over truth, score >= 4: median {np.median(ratios):.3f} (within 5 %), n {len(ratios)}")
    for group in ("held_out_sensors", "held_out_modes"):
        some = [(r[f"{group}_before"], r[f"{group}_after"]) for r in rows if f"{group}_after" in r]
        if some:
            before, after = (np.array([pair[k][0] / pair[k][1] for pair in some]) for k in (0, 1))
            print(f"{group}: rms over expected {_rms(before):.3f} before, {_rms(after):.3f} after, n {len(some)}")
    if null:
        for key in ("p_named", "p_perturbations", "p_family", "p_fit"):
            p = np.array([r[key] for r in null])
            shares = ", ".join(f"{100 * np.mean(p < a):.1f} % < {a:g}" for a in (0.01, 0.05, 0.2))
            print(f"{key:9s} with nothing missing: {shares} (n {len(p)})")
    spent = np.array([r["evaluations"] for r in rows])
    most = np.quantile(spent, 0.9)
    print(f"evaluations: median {np.median(spent):.0f}, 90 % {most:.0f}, largest {spent.max()} (required 150)")
    print(f"seconds: median {np.median([r['seconds'] for r in rows]):.1f}")


def _by_effect(rows: Sequence[Row]) -> None:
    print(f"\n{'scenario':34s} {'n':>3s} {'score':>12s}  outcomes")
    for name in dict.fromkeys(sorted(r["scenario"] for r in rows)):
        own = [r for r in rows if r["scenario"] == name]
        z = [score(r) for r in own]
        span = f"{min(z):.1f}-{max(z):.1f}" if own[0]["hidden"] else ""
        counts = ", ".join(f"{k} {v}" for k, v in Counter(r["outcome"] for r in own).most_common())
        print(f"{name:34s} {len(own):3d} {span:>12s}  {counts}")


def _exceptions(rows: Sequence[Row], failed: Sequence[Row]) -> None:
    print("\nruns that went wrong:")
    for r in failed:
        print(f"- {r['scenario']} #{r['number']}: {r['error']}")
    for r in rows:
        words = _complaint(r)
        if words:
            _show(r, words)


def _complaint(r: Row) -> str:
    if wrong(r) or (named(r) and r["group"] != "single" and not r["hidden"]):
        return "wrong name"
    if r["group"] == "single" and score(r) >= 4 and r["outcome"] not in ("right", "second"):
        return f"not named ({r['outcome']})"
    if r["outcome"] == "second":
        return "not the best of the set"
    if r["group"] in ("nothing", "fifty") and r["verdict"] != "nothing_detectable":
        return f"false alarm ({r['verdict']})"
    if r["group"] == "noise" and r["verdict"] not in ("nothing_detectable", "noise_underestimated"):
        return f"not cleared ({r['verdict']})"
    if (
        r["group"] in ("outside", "removed")
        and score(r) >= DETECTABLE
        and r["verdict"] not in ("none_explains", "misfit_unlocated")
    ):
        return f"outside: {r['verdict']}"
    if r["group"] in ("pair", "triple") and score(r) >= DETECTABLE and r["outcome"] != "right":
        return f"{r['group']}: {r['outcome']}"
    return ""


def _show(r: Row, words: str) -> None:
    print(f"- {r['scenario']} #{r['number']}: {words}; truth {r['magnitudes']}, z {r['z']}, visible {r['visible']}")
    print(
        f"    {r['verdict']} {r['best']} of {r['credible']}; base p named {r['p_named']:.2g}, "
        f"perturbations {r['p_perturbations']:.2g}, fit {r['p_fit']:.2g}; scale {r['measured_scale']:.2f}; "
        f"places {r['places_right']}, {r.get('places_right_after')}; after {r.get('after')}"
    )
    for t in (*r["candidate_fits"], *([r["perturbation"]] if r["perturbation"] else [])):
        print(f"    {' + '.join(t['names'])}: ln B {t['ln_bayes']}, {t['values']} {t['implausible']}")


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))
