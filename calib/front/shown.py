"""What an answer shows of itself: sentences, and a table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import pandas as pd

from calib.joint import said, stacked
from calib.questions import compare


class Shown:
    """An answer that prints as sentences and a table, in a notebook too."""

    @property
    def sentences(self) -> tuple[str, ...]:
        """What was found, the most important first."""
        raise NotImplementedError

    @property
    def table(self) -> pd.DataFrame:
        """What is shown below them."""
        raise NotImplementedError

    def __str__(self) -> str:
        words = "\n".join(self.sentences)
        return f"{words}\n\n{self.table.to_string(index=False, float_format='%.4g')}"

    def _repr_html_(self) -> str:
        words = "".join(f"<p>{escape(sentence)}</p>" for sentence in self.sentences)
        return words + str(self.table.to_html(index=False, float_format=lambda v: f"{v:.4g}", na_rep=""))


@dataclass(frozen=True, eq=False, repr=False)
class Compared(Shown):
    """Models against tests at one point.

    Attributes
    ----------
    by_test : mapping from str to Answer
        Of each test.
    """

    by_test: Mapping[str, compare.Answer]

    @property
    def sentences(self) -> tuple[str, ...]:
        """Where each model fails, and what makes pairs or units doubtful."""
        return said({name: (*answer.sentences, *_told(answer)) for name, answer in self.by_test.items()})

    @property
    def table(self) -> pd.DataFrame:
        """One row a measured mode or response, with a column ``test`` where there are several."""
        tables = {name: answer.table for name, answer in self.by_test.items()}
        return stacked(tables) if len(tables) > 1 else next(iter(tables.values()))

    def __repr__(self) -> str:
        return f"Compared({', '.join(f'{name}: {len(answer.table)} rows' for name, answer in self.by_test.items())})"


@dataclass(frozen=True, eq=False, repr=False)
class Answer(Shown):
    """What a study answers: sentences and the table that shows it.

    Attributes
    ----------
    words : tuple of str
    rows : DataFrame
    folder : Path
        Where all tables and figures are.
    of : object
        Everything that was found, such as a `calib.questions.calibrate.Calibration`.
    """

    words: tuple[str, ...]
    rows: pd.DataFrame
    folder: Path
    of: Any

    @property
    def sentences(self) -> tuple[str, ...]:
        """What was found, the most important first."""
        return self.words

    @property
    def table(self) -> pd.DataFrame:
        """What shows it."""
        return self.rows

    def __repr__(self) -> str:
        return f"Answer({len(self.rows)} rows in {self.folder})"


def _told(answer: compare.Answer) -> list[str]:
    """Suspicious sensors, and the mean error of plain responses."""
    out = [finding.sentence for finding in answer.findings]
    if answer.comparison is None:
        out.append(f"The mean absolute error is {100 * answer.mean_freq_error:.2f} %.")
    return out
