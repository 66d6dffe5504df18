"""What an answer shows of itself: sentences, and a table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from html import escape

import pandas as pd


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
    by_test : mapping from str to (DataFrame, str)
        Of each test its table, and where the model fails, in words.
    """

    by_test: Mapping[str, tuple[pd.DataFrame, str]]

    @property
    def sentences(self) -> tuple[str, ...]:
        """Where each model fails."""
        several = len(self.by_test) > 1
        return tuple(f"{name}: {words}" if several else words for name, (_, words) in self.by_test.items())

    @property
    def table(self) -> pd.DataFrame:
        """One row a measured mode or response, with a column ``test`` where there are several."""
        tables = [table for table, _ in self.by_test.values()]
        if len(tables) == 1:
            return tables[0]
        return pd.concat([t.assign(test=n) for n, t in zip(self.by_test, tables, strict=True)], ignore_index=True)

    def __repr__(self) -> str:
        return f"Compared({', '.join(f'{name}: {len(table)} rows' for name, (table, _) in self.by_test.items())})"
