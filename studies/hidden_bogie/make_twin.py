"""Synthetic measurements of the blind bogie studies: an effect of the library, none, one outside the library, or three.

    python studies/hidden_bogie/make_twin.py effect TRUTH.json --into studies/hidden_bogie/measured
    python studies/hidden_bogie/make_twin.py nothing TRUTH.json --into studies/hidden_bogie_none/measured
    python studies/hidden_bogie/make_twin.py outside TRUTH.json --into studies/hidden_bogie_outside/measured
    python studies/hidden_bogie/make_twin.py three TRUTH.json --into studies/hidden_three/measured

The twin is that of ``studies/bogie`` (mesh three times finer, distributed masses, sensors off by up to 5 mm, the same
noise) with nine modes; its actuators stand at any of the places 3 to 7. ``studies/blind_twin.py`` describes what else
is drawn and the criteria. The three effects together are really built into the mesh (``remodelled.py``), the others are
the library's terms. The true values are written to TRUTH.json, which no analysis reads.
"""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path

from calib.study.loading import module_of
from models.railway import bogie_effects, bogie_on_rig

HERE = Path(__file__).resolve().parent

blind = module_of(HERE.parent / "blind_twin.py")
outside = module_of(HERE / "outside.py")
remodelled = module_of(HERE / "remodelled.py")

KINDS = {
    "effect": blind.Kind(1, 1),
    "nothing": blind.Kind(1001),
    "outside": blind.Kind(2001, 1, inside=False),
    "three": blind.Kind(3001, 3),
}


def specimen(really_built: bool = False, element_size: float = 0.025) -> blind.Specimen:
    """The bogie on its rig; its effects are the library's terms, or really built into the twin's mesh (size in m)."""
    base, layout = bogie_on_rig(), blind.twin.sensors()
    modes = tuple(f"{k}BT" for k in range(1, 10))
    fine = {"element_size": element_size, "distributed": True}
    nominal = base.sensor_rows(layout) @ base.modes(base.space.values, len(modes)).shapes
    return blind.Specimen(
        file=HERE / "study.toml", base=base, fine=bogie_on_rig(**fine), library=bogie_effects(),
        outside=outside.outside_effects(), modes=modes, layout=layout,
        nominal=nominal[:, : len(modes)], positions=(3, 7),
        built=partial(remodelled.built, **fine) if really_built else None,
    )  # fmt: skip


if __name__ == "__main__":
    three = "three" in sys.argv[1:2]
    blind.make(specimen(really_built=three), KINDS, "bogie test", (__doc__ or "").splitlines()[0])
