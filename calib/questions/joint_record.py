"""What an answer of several tests stands on, kept beside it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import pandas as pd

from calib.joint import of_test
from calib.questions.record import (
    asked,
    assumptions_table,
    disagreements_table,
    earlier,
    measured_table,
    sensors_table,
)
from calib.questions.scatter import accuracy_words, assumed_words, scatter_notes
from calib.results import Results
from calib.several import JointStudy
from calib.study import Study


def write_joint_record(
    study: JointStudy,
    results: Results,
    question: str,
    seeds: Mapping[str, int],
    sentences: Sequence[str] = (),
    quick: bool = False,
) -> None:
    """As `calib.questions.record.write_record`; tables have the rows of all tests with a column ``test``."""
    modal = [s for s in study.studies if s.whole is not None and s.whole.has_shapes]
    tables: Mapping[str, tuple[Callable[[Study], pd.DataFrame], Sequence[Study]]] = {
        "measured": (measured_table, study.studies),
        "sensors": (lambda s: sensors_table(s.whole, s.settings.withheld.sensors), modal),  # type: ignore[arg-type]
        "repeat_disagreements": (disagreements_table, study.studies),
        "assumptions": (assumptions_table, study.studies),
    }
    for name, (table, of) in tables.items():
        if of:
            results.write_table(name, pd.concat([table(s).assign(test=s.test) for s in of], ignore_index=True))
    results.write_table("parameter_space", study.search_space.frame())
    words = {s.test: (accuracy_words(s), assumed_words(s)) for s in study.studies}
    notes = [of_test(s.test, note) for s in study.studies for note in (*s.measurement_notes, *scatter_notes(s))]
    record = {
        "study": study.name,
        "title": study.settings.title,
        "synthetic": study.synthetic,
        "model": study.settings.model,
        "tests": [s.test for s in study.studies],
        "effects_known": len(study.library),
        "effects_in_model": list(study.settings.with_effects),
        "files": list(study.named_files),
        "accuracy": "; ".join(of_test(test, claimed) for test, (claimed, _) in words.items()),
        "scatter_assumed": "; ".join(of_test(test, assumed) for test, (_, assumed) in words.items() if assumed),
        "notes": [note.removesuffix(".") for note in notes],
        "questions": {**earlier(results, question), question: asked(study, question, seeds, sentences, quick)},
    }
    results.write_json("record", record)
