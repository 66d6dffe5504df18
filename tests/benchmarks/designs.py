"""Seconds of one cloud of many designs, drawn and written; wanted: 100,000 within 3 s.

python tests/benchmarks/designs.py [--designs 100000] [--turns 3]
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd

from calib.report.designs import draw_anthill
from calib.report.style import owner_of, save, style


def main() -> None:
    """Print wall clock and processor time of each turn."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--designs", type=int, default=100_000)
    options.add_argument("--turns", type=int, default=3)
    given = options.parse_args()
    random = np.random.default_rng(0)
    x = random.normal(size=given.designs)
    table = pd.DataFrame({"x": x, "y": x**2 + random.normal(size=given.designs)})
    with tempfile.TemporaryDirectory() as folder:
        for turn in range(given.turns):
            wall, processor = time.perf_counter(), time.process_time()
            with style():
                save(owner_of(draw_anthill(table, "x", "y")), Path(folder) / f"cloud{turn}")
            own = time.process_time() - processor
            print(f"{given.designs} designs: {time.perf_counter() - wall:.1f} s, processor {own:.1f} s")


if __name__ == "__main__":
    main()
