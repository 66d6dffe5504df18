"""Labels of the rows of a residual: what each compares, and how its standard deviation is known."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    import pandas as pd


class Label(Protocol):
    """Label of one row of the residual, a named tuple; a test may add columns of its own to these three."""

    @property
    def mode(self) -> str:
        """Measured mode; empty for a scalar response."""
        ...

    @property
    def kind(self) -> str:
        """Kind of response, such as ``frequency``, ``damping``, ``shape`` or ``response``."""
        ...

    @property
    def sensor(self) -> str:
        """Sensor of a shape or name of a scalar response, else empty."""
        ...

    def _asdict(self) -> dict[str, Any]:
        """All columns of the label by name."""
        ...


class Labelled(Protocol):
    """Anything with a residual whose rows have labels."""

    @property
    def rows(self) -> Sequence[Label]:
        """Labels of the rows, length n_rows."""
        ...

    @property
    def fitted_factors(self) -> Mapping[tuple[str, str], int]:
        """Real numbers that the residual fits itself, such as the scale of a shape, by (mode, kind)."""
        ...

    @property
    def std_dof(self) -> Mapping[str, float]:
        """Degrees of freedom behind the standard deviations of each kind of row; infinite where they are known."""
        ...


def label_table(rows: Sequence[Label]) -> pd.DataFrame:
    """Labels of rows as a table, n_rows, with every column that any of them has; empty where a row has none."""
    import pandas as pd

    table = pd.DataFrame([row._asdict() for row in rows])
    return table.astype(object).where(table.notna(), "").infer_objects()


@dataclass(frozen=True)
class RowLabels:
    """Labels of rows with their fitted factors and degrees of freedom; see `Labelled`.

    Attributes
    ----------
    rows : sequence of Label
    fitted_factors : mapping from (mode, kind) to int
    std_dof : mapping from kind to float
        Infinite for a missing kind.
    """

    rows: Sequence[Label]
    fitted_factors: Mapping[tuple[str, str], int] = field(default_factory=dict)
    std_dof: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, whole: Labelled, kept: Iterable[int]) -> RowLabels:
        """Selected rows, by index."""
        return cls([whole.rows[k] for k in kept], whole.fitted_factors, whole.std_dof)
