"""Writes the deck of a frame for CalculiX: two plates of shells, columns and ribs of beams, springs below the columns.

    python studies/calculix_frame/make_frame.py > studies/calculix_frame/frame.inp

Lengths in mm, masses in t, forces in N. The deck of the model has parameters where ``{{ name }}`` stands; that of the
twin has numbers, another mesh, and what the model lacks.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

LENGTH, WIDTH, HEIGHT = 600.0, 400.0, 350.0
COLUMN = 22.0
"""Side of the square section of a column."""
RIB = 12.0
"""Side of the square section of a rib."""
FEET = [(75.0, 50.0), (525.0, 50.0), (75.0, 350.0), (525.0, 350.0)]
"""Places of the columns on the plates."""
SENSORS = [
    (plate, x, y) for plate in ("base", "top") for x in (0.0, 150.0, 300.0, 450.0, 600.0) for y in (0.0, 200.0, 400.0)
]
"""Measured places of the plates, which are nodes of every mesh."""


@dataclass
class Deck:
    """Nodes and elements of a frame, numbered as they come.

    Attributes
    ----------
    columns, rows : int
        Elements of 8 nodes along the length and the width of a plate; multiples of 8.
    segments : int
        Beams of 3 nodes in a column.
    """

    columns: int = 16
    rows: int = 8
    segments: int = 4
    nodes: list[str] = field(default_factory=list)
    elements: dict[str, list[str]] = field(default_factory=dict)
    at: dict[tuple[float, float, float], int] = field(default_factory=dict)

    def node(self, x: float, y: float, z: float) -> int:
        """Number of the node at a place, which is made once."""
        key = (round(x, 6), round(y, 6), round(z, 6))
        if key not in self.at:
            self.at[key] = len(self.at) + 1
            self.nodes.append(f"{self.at[key]},{key[0]},{key[1]},{key[2]}")
        return self.at[key]

    def element(self, kind: str, *nodes: int) -> None:
        """Add an element to a set."""
        number = sum(map(len, self.elements.values())) + 1
        self.elements.setdefault(kind, []).append(",".join(map(str, (number, *nodes))))

    def plate(self, name: str, z: float) -> None:
        """Shells of 8 nodes."""
        dx, dy = LENGTH / self.columns, WIDTH / self.rows
        for i in range(self.columns):
            for j in range(self.rows):
                x, y = i * dx, j * dy
                corners = [(x, y), (x + dx, y), (x + dx, y + dy), (x, y + dy)]
                ring = [*corners, *((0.5 * (p[0] + q[0]), 0.5 * (p[1] + q[1]))
                                    for p, q in zip(corners, corners[1:] + corners[:1], strict=True))]  # fmt: skip
                self.element(name, *(self.node(*point, z) for point in ring))

    def column(self, x: float, y: float) -> None:
        """Beams of 3 nodes between the plates."""
        step = HEIGHT / self.segments
        for k in range(self.segments):
            ends = (k * step, (k + 0.5) * step, (k + 1) * step)
            self.element("COLUMNS", *(self.node(x, y, z) for z in ends))

    def rib(self, y: float) -> None:
        """Beams along the nodes of the upper plate between two columns."""
        step, first, last = LENGTH / self.columns, FEET[0][0], FEET[1][0]
        for k in range(round((last - first) / step)):
            self.element("RIBS", *(self.node(first + (k + part) * step, y, HEIGHT) for part in (0.0, 0.5, 1.0)))


def frame(values: Mapping[str, object], columns: int = 16, rows: int = 8, segments: int = 4, more: str = "",
          step: str = "") -> str:  # fmt: skip
    """The deck, with these values or placeholders.

    Parameters
    ----------
    values : mapping
        ``E_plates, E_columns`` (N/mm2), ``t_top`` (mm) and ``k_feet`` (N/mm).
    columns, rows, segments : int
        See `Deck`.
    more : str
        Further lines of the model, with ``NODE x y z`` for the number of a node.
    step : str
        By default modes or matrices as the template's variable ``matrices`` tells.
    """
    deck = Deck(columns, rows, segments)
    deck.plate("BASE", 0.0)
    deck.plate("TOP", HEIGHT)
    for x, y in FEET:
        deck.column(x, y)
        deck.element("FEET", deck.node(x, y, 0.0))
    for y in sorted({y for _, y in FEET}):
        deck.rib(y)
    seen = [deck.node(x, y, 0.0 if plate == "base" else HEIGHT) for plate, x, y in SENSORS]
    lines = ["*HEADING", "Frame of two plates and four columns; mm, t, N", "*NODE, NSET=NALL", *deck.nodes]
    for name, kind in (("BASE", "S8R"), ("TOP", "S8R"), ("COLUMNS", "B32R"), ("RIBS", "B32R")):
        lines += [f"*ELEMENT, TYPE={kind}, ELSET={name}", *deck.elements[name]]
    for direction, name in ((1, "FEETX"), (2, "FEETY"), (3, "FEETZ")):
        first = 100_000 * direction
        lines += [f"*ELEMENT, TYPE=SPRING1, ELSET={name}"]
        lines += [f"{first + k},{one.split(',')[1]}" for k, one in enumerate(deck.elements["FEET"], start=1)]
        lines += [f"*SPRING, ELSET={name}", str(direction), str(values["k_feet"])]
    lines += ["*NSET, NSET=SENSORS", *(f"{node}," for node in seen)]
    for name, modulus in (("PLATES", values["E_plates"]), ("STEEL", values["E_columns"])):
        lines += [f"*MATERIAL, NAME={name}", "*ELASTIC", f"{modulus},0.3", "*DENSITY", "7.85E-9"]
    lines += ["*SHELL SECTION, ELSET=BASE, MATERIAL=PLATES", "10.0"]
    lines += ["*SHELL SECTION, ELSET=TOP, MATERIAL=PLATES", str(values["t_top"])]
    lines += ["*BEAM SECTION, ELSET=COLUMNS, MATERIAL=STEEL, SECTION=RECT", f"{COLUMN},{COLUMN}", "1.0,0.0,0.0"]
    lines += ["*BEAM SECTION, ELSET=RIBS, MATERIAL=STEEL, SECTION=RECT", f"{RIB},{RIB}", "0.0,1.0,0.0"]
    lines += [_numbered(line, deck) for line in more.splitlines()]
    return "\n".join([*lines, step or STEP]) + "\n"


STEP = """*STEP
*FREQUENCY{{ ", SOLVER=MATRIXSTORAGE" if matrices }}
{% if not matrices %}16
*NODE PRINT, NSET=SENSORS
U
{% endif %}*END STEP"""
"""One template for both jobs: the matrices, or the modes."""


def _numbered(line: str, deck: Deck) -> str:
    """A line in which ``NODE x y z`` is replaced by the number of the node there."""
    before, found, place = line.partition("NODE ")
    return line if not found else f"{before}{deck.node(*map(float, place.split()))}"


if __name__ == "__main__":
    print(frame({name: f"{{{{ {name} }}}}" for name in ("E_plates", "E_columns", "t_top", "k_feet")}), end="")
