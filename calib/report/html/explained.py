"""Sections on the explanation: parameter pulls, the verdict, and the candidate fits."""

from __future__ import annotations

from calib.report.html.limits import TESTS
from calib.report.html.page import Block, Section, Table, Words
from calib.report.html.study_results import StudyResults
from calib.report.numbers import chance, fixed, flag, with_unit, yes


def pulls(results: StudyResults) -> Section | None:
    """Standardised shifts of the parameters, without and with the candidate effects."""
    numbers = ["nominal", "value", "prior_sd", "standardised", "limit"]
    table = results.table(
        "pulls", ["model", "parameter"], numbers, flags=["pulled"], blank=["unit"], unbounded=["standardised"]
    )
    if table is None:
        return None
    pulled = [f"{r['parameter']} ({r['model']})" for r in table.to_dict("records") if flag(r["pulled"])]
    note = f"Pulled: {', '.join(pulled)}." if pulled else "No parameter is pulled."
    rows = tuple(
        (
            str(r["parameter"]),
            str(r["model"]),
            with_unit(r["nominal"], str(r["unit"]), 4),
            with_unit(r["value"], str(r["unit"]), 4),
            fixed((r["value"] - r["nominal"]) / r["prior_sd"], 2, sign=True),
            fixed(r["standardised"], 2, sign=True),
            yes(r["pulled"]),
        )
        for r in table.to_dict("records")
    )
    intro = (
        "A parameter that is pulled far from its nominal value may compensate for missing physics. The pull is its "
        "shift over the standard deviation that the shift has in a correctly specified model, so that there it is "
        "standard normal. A parameter that the data hardly "
        "see should stay at its nominal value: one that moves all the same is pulled strongly, by a misfit that "
        "has its pattern."
    )
    caption = f"Shift of every parameter from its nominal value. {note}"
    wider = _unexplained(results)
    heads = ("parameter", "model", "nominal", "fitted", "shift, prior std", "pull", "pulled")
    return Section(
        "pulled",
        "Parameter pulls",
        (
            Words(intro),
            *results.picture("pulls", caption, f"Dots. {note}"),
            Table("Parameter pulls", heads, rows, (1, 6)),
            *wider,
        ),
    )


def _unexplained(results: StudyResults) -> tuple[Block, ...]:
    """Intervals of the parameters with the unexplained misfit; nothing where everything is explained."""
    numbers = ["value", "low", "high", "value_unexplained", "low_unexplained", "high_unexplained"]
    table = results.table("unexplained", ["parameter"], numbers, blank=["unit"])
    if table is None:
        return ()
    rows = tuple(
        (str(r["parameter"]), *(with_unit(r[name], str(r["unit"]), 4) for name in numbers))
        for r in table.to_dict("records")
    )
    words = (
        "A misfit that nothing explains may have pulled the parameters. The last columns take every effect of the "
        "library and every local perturbation as present a little, as much as the misfit says (95 % intervals)."
    )
    alone, beside = (
        ("fit alone", "lower end", "upper end"),
        ("with the misfit", "lower end with it", "upper end with it"),
    )
    return Words(words), Table("Parameters with the unexplained misfit", ("parameter", *alone, *beside), rows, ())


def verdict(results: StudyResults) -> Section | None:
    """The verdict in full, with its support."""
    explanation = results.explanation
    if not explanation:
        return None
    facts = [(words, explanation.get(name)) for name, words in TESTS.items()]
    rows = tuple((words, chance(float(p))) for words, p in facts if p is not None)
    notes = [Words(str(note), "reported") for note in explanation.get("notes", [])]
    sentences = explanation.get("sentences", [explanation.get("sentence", "")])
    parts = [str(words).replace(" -> ", " → ") for words in sentences]
    sure = results.answer("explain").get("sure", "").replace(" -> ", " → ")  # it stands at the top of the page
    supports = [Words(words, "reported") for words in parts[1:] if words != sure]
    table = Table("Tests of the explanation", ("test", "p"), rows)
    blocks: list[Block] = [Words(parts[0], "verdict"), *supports, *notes, table]
    return Section("verdict", "Verdict", tuple(blocks))


def candidate_fits(results: StudyResults) -> Section | None:
    """Every model that was fitted."""
    table = results.table("candidate_fits", ["effects"], ["misfit", "ln_bayes"], blank=["implausible"])
    if table is None:
        return None
    rows = tuple(
        (str(r["effects"]), fixed(r["misfit"], 1), fixed(r["ln_bayes"], 1), str(r["implausible"]))
        for r in table.to_dict("records")
    )
    count = results.explanation.get("evaluations")
    work = f" They took {count} evaluations of the model." if count else ""
    intro = f"All models that were fitted.{work} The misfit is the sum of squares in standard deviations."
    heads = ("added to the base model", "misfit", "ln Bayes", "implausible because")
    return Section("candidate_fits", "Candidate fits", (Words(intro), Table("Candidate fits", heads, rows, (3,))))
