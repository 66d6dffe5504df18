"""Made the example's measurement: a mast with five times finer elements and a distributed antenna, plus noise.

python tests/template/make_measurement.py FOLDER
"""

import sys
from importlib import resources
from pathlib import Path

import numpy as np

from calib.measurement.modal import Sensor
from calib.study.loading import module_of

TRUTH = {"E": 203.0, "m_top": 52.0, "K_base": 1.1}
NAMES = ("B1x", "B1z", "B2x", "B2z")
STD_FREQ, STD_SHAPE = 0.003, 0.02


def main(folder: Path) -> None:
    model = module_of(Path(str(resources.files("calib") / "template/model.py.txt"))).mast(element_size=0.1)
    rng = np.random.default_rng(20)
    layout = [Sensor(k + 1, d, (0.0, y, 0.0), "mast") for k, y in enumerate((1.5, 3.0, 4.5, 6.0)) for d in "xz"]
    modes = model.modes(TRUTH, 6)
    shapes = model.sensor_rows(layout) @ modes.shapes
    x, z = (np.abs(shapes[[i for i, s in enumerate(layout) if s.direction == d]]).sum(0) for d in "xz")
    order = [int(k) for bending in (x > 3 * z, z > 3 * x) for k in np.flatnonzero(bending)[:2]]
    order = [order[0], order[2], order[1], order[3]]
    head = "# SYNTHETIC example data: computed with a finer model than the example's, plus noise.\n"
    rows = ["mode,freq,freq_kind,freq_std,damping,damping_std"]
    lines = ["mode,node,direction,re,im,std"]
    for name, k in zip(NAMES, order, strict=True):
        freq = modes.natural_freq[k] * (1 + STD_FREQ * rng.standard_normal())
        rows.append(f"{name},{freq:.4f},natural,{STD_FREQ * freq:.4f},0.004,0.0004")
        shape = shapes[:, k] / np.abs(shapes[:, k]).max()
        for sensor, value in zip(layout, shape + STD_SHAPE * rng.standard_normal(len(layout)), strict=True):
            lines.append(f"{name},{sensor.node},{sensor.direction},{value:.5f},0,{STD_SHAPE}")
    more = "# Many repeats in one table: add a column repeat (any label) here and in shapes.csv; "
    more += "leave out the lines of what one lacks.\n"
    (folder / "modes.csv").write_text(head + more + "\n".join(rows) + "\n", encoding="utf-8")
    (folder / "shapes.csv").write_text(head + "\n".join(lines) + "\n", encoding="utf-8")
    points = {s.node: s.point for s in layout}
    table = ["node,x,y,z,on"] + [f"{n},{p[0]},{p[1]},{p[2]},mast" for n, p in points.items()]
    (folder / "sensors.csv").write_text("\n".join(table) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
