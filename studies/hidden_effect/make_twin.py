"""Synthetic measurements of the five blind studies of the whole vehicle.

    python studies/hidden_effect/make_twin.py effect TRUTH.json --into studies/hidden_effect/measured
    python studies/hidden_effect/make_twin.py nothing TRUTH.json --into studies/hidden_none/measured
    python studies/hidden_effect/make_twin.py outside TRUTH.json --into studies/hidden_outside/measured
    python studies/hidden_effect/make_twin.py two TRUTH.json --into studies/hidden_two/measured
    python studies/hidden_effect/make_twin.py noise TRUTH.json --into studies/hidden_noise/measured

The twin has every edge of its shells halved, finer beams and distributed masses, like that of ``studies/vehicle``; it
shows the twelve modes measured there. Its hung units are those of ``units.py``. For ``noise`` nothing is hidden, but
the repeats show only half of the true standard deviation: the rest is an error that they share.
``studies/blind_twin.py`` describes what else is drawn and the criteria. The true values are written to TRUTH.json,
which no analysis reads.
"""

from __future__ import annotations

from pathlib import Path

from calib.study.loading import module_of
from models.railway import vehicle, vehicle_effects

HERE = Path(__file__).resolve().parent

blind = module_of(HERE.parent / "blind_twin.py")
test = module_of(HERE.parent / "vehicle" / "make_twin.py")
outside = module_of(HERE / "outside.py")
units = module_of(HERE / "units.py")

KINDS = {
    "effect": blind.Kind(1, 1),
    "nothing": blind.Kind(1001),
    "outside": blind.Kind(2001, 1, inside=False),
    "two": blind.Kind(3001, 2),
    "noise": blind.Kind(4001, noise=2.0),
}


def specimen() -> blind.Specimen:
    """The vehicle with seats that move with its floor."""
    base, layout = vehicle(seats="rigid"), test.sensors()
    return blind.Specimen(
        file=HERE / "study.toml", base=base, fine=vehicle(refine=2, distributed=True, seats="rigid"),
        library=units.of_the_twin(vehicle_effects()), outside=outside.outside_effects(),
        modes=test.MODES, layout=layout, nominal=test.named(base, base.space.values, layout)[1],
    )  # fmt: skip


if __name__ == "__main__":
    blind.make(specimen(), KINDS, "vehicle test", (__doc__ or "").splitlines()[0])
