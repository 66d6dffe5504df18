"""What blind runs are made of: a family of blind studies, and how it is measured."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Subject:
    """One family of blind studies.

    Attributes
    ----------
    name : str
    study : str
        One of the studies, for its settings; its measurement is not used.
    sources : tuple of str
        Files that its measurements depend on, beside the code that answers.
    outside : tuple of str
        Designs that no effect describes.
    pairs : tuple of (str, str)
        Effects that are hidden together.
    triples : tuple of (str, str, str)
        The same of three effects.
    really_built : bool
        Whether effects of the library are built into the twin's mesh, instead of added as the library's terms.
    reduced_twin : bool
        Whether the finer mesh is solved on a reduced basis of its own, for which full order would take too long.
    suspects : bool
        Whether measurement errors are candidates, as in a study.
    ways : tuple of str
        Names of the ways in which each structure is measured and explained, where there are several.
    """

    name: str
    study: str
    sources: tuple[str, ...]
    outside: tuple[str, ...]
    pairs: tuple[tuple[str, str], ...]
    triples: tuple[tuple[str, str, str], ...] = ()
    really_built: bool = False
    reduced_twin: bool = False
    suspects: bool = False
    ways: tuple[str, ...] = ()

    @property
    def maker(self) -> Path:
        """The generator of the blind studies."""
        return ROOT / self.sources[0]


BOGIE = Subject(
    "bogie", "studies/hidden_bogie_none",
    (
        "studies/hidden_bogie/make_twin.py", "studies/hidden_bogie/outside.py", "studies/hidden_bogie/remodelled.py",
        "studies/hidden_bogie/study.toml",
        "studies/bogie/make_twin.py", "studies/blind_twin.py",
    ),
    ("heavy_rear", "stiff_rear_rods", "soft_girder", "skew_block"),
    (
        ("brake_unit", "weak_damper"), ("crossbar_mass", "rolling_wheels"), ("gear_case_offset", "primary_uneven"),
        ("damper_mount", "rod_damping"),
    ),
    (
        ("brake_unit", "weak_damper", "gear_case_offset"), ("crossbar_mass", "damper_mount", "primary_uneven"),
        ("rolling_wheels", "primary_uneven", "block_damping"), ("torque_link", "rod_damping", "actuator_flexibility"),
    ),
    really_built=True,
)  # fmt: skip

BOGIE_SUSPECTS = replace(BOGIE, name="bogie_suspects", suspects=True)
"""The same tests again."""

VEHICLE = Subject(
    "vehicle", "studies/hidden_none",
    (
        "studies/hidden_effect/make_twin.py", "studies/hidden_effect/outside.py", "studies/hidden_effect/units.py",
        "studies/hidden_bogie/outside.py",
        "studies/hidden_effect/study.toml", "studies/vehicle/make_twin.py", "studies/bogie/make_twin.py",
        "studies/blind_twin.py",
    ),
    ("soft_rear_wall", "heavy_front", "soft_rear_frame", "stiff_rear_primary"),
    (
        ("neighbour_coupling", "body_damping"), ("air_spring", "hung_roof_unit"), ("damper_asymmetry", "tipping"),
        ("secondary_asymmetry", "yaw_damper_mount"),
    ),
    reduced_twin=True,
)  # fmt: skip

PANEL = Subject(
    "panel", "studies/hidden_panel",
    (
        "studies/hidden_panel/make_twin.py", "studies/hidden_panel/remodelled.py", "studies/hidden_panel/study.toml",
        "studies/hidden_panel_frf/study.toml", "studies/frf_twin.py", "calib/hypotheses/linear_start.py",
        "tests/benchmarks/rates_panel.py",
    ),
    ("heavy_left", "broken_bar", "corner_mass"), (), ways=("modes", "frfs", "freed", "ignored"),
)  # fmt: skip

BOGIE_FRF = replace(
    BOGIE, name="bogie_frf", pairs=(), triples=(), ways=("modes", "frfs"),
    sources=(
        *BOGIE.sources, "studies/hidden_bogie_frf/make_twin.py", "studies/hidden_bogie_frf/study.toml",
        "studies/frf_twin.py", "calib/hypotheses/linear_start.py", "tests/benchmarks/rates_bogie_frf.py",
    ),
)  # fmt: skip

BOGIE_FAULT = replace(
    BOGIE, name="bogie_fault", suspects=True,
    sources=(*BOGIE.sources, "tests/benchmarks/rates_faults.py", "calib/hypotheses/linear_start.py"),
)  # fmt: skip

FRAME = Subject(
    "frame", "", ("tests/benchmarks/rates_frame.py", "studies/blind_twin.py", "studies/bogie/make_twin.py"),
    ("soft_storey", "heavy_bay"), (), really_built=True,
)  # fmt: skip

FRAME_FAULT = replace(
    FRAME, name="frame_fault", suspects=True, sources=(*FRAME.sources, "tests/benchmarks/rates_faults.py")
)

FRAME_FRF = replace(
    FRAME, name="frame_frf", suspects=True,
    sources=(*FRAME.sources, "tests/benchmarks/rates_frame_frf.py", "studies/frf_twin.py",
             "calib/hypotheses/linear_start.py"),
)  # fmt: skip

CHAIN = Subject(
    "chain", "studies/five_mass_chain",
    ("studies/five_mass_chain", "models/five_mass_chain.py", "tests/benchmarks/chain_rates.py"), (), (),
)  # fmt: skip

SUBJECTS = {
    s.name: s for s in (
        BOGIE, BOGIE_SUSPECTS, BOGIE_FRF, BOGIE_FAULT, VEHICLE, PANEL, FRAME, FRAME_FAULT, FRAME_FRF, CHAIN,
    )
}  # fmt: skip
