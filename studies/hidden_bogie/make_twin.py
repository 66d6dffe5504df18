"""Synthetic measurements of the three blind bogie studies: an effect of the library, none, or one outside the library.

    python studies/hidden_bogie/make_twin.py effect TRUTH.json --into studies/hidden_bogie/measured
    python studies/hidden_bogie/make_twin.py nothing TRUTH.json --into studies/hidden_bogie_none/measured
    python studies/hidden_bogie/make_twin.py outside TRUTH.json --into studies/hidden_bogie_outside/measured

The twin is that of ``studies/bogie`` (mesh three times finer, distributed masses, sensors off by up to 5 mm, the same
noise) with nine modes; its actuators stand at any of the places 3 to 7. ``studies/blind_twin.py`` describes what else
is drawn and the criteria. The true values are written to TRUTH.json, which no analysis reads.
"""

from __future__ import annotations

from pathlib import Path

from calib.loading import module_of
from models.railway import bogie_effects, bogie_on_rig

HERE = Path(__file__).resolve().parent

blind = module_of(HERE.parent / "blind_twin.py")
outside = module_of(HERE / "outside.py")

KINDS = {
    "effect": blind.Kind(1, 1),
    "nothing": blind.Kind(1001),
    "outside": blind.Kind(2001, 1, inside=False),
}


def specimen() -> blind.Specimen:
    """The bogie on its rig."""
    base, layout = bogie_on_rig(), blind.twin.sensors()
    modes = tuple(f"{k}BT" for k in range(1, 10))
    nominal = base.sensor_rows(layout) @ base.modes(base.space.values, len(modes)).shapes
    return blind.Specimen(
        file=HERE / "study.toml", base=base, fine=bogie_on_rig(element_size=0.025, distributed=True),
        library=bogie_effects(), outside=outside.outside_effects(), modes=modes, layout=layout,
        nominal=nominal[:, : len(modes)], positions=(3, 7),
    )  # fmt: skip


if __name__ == "__main__":
    blind.make(specimen(), KINDS, "bogie test", (__doc__ or "").splitlines()[0])
