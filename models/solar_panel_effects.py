"""Library of effects that the model of the solar array may lack; they keep the meaning of its parameters.

Plausible sizes (``prior_sd``) and limits are engineering estimates for an array of this size. With magnitude 0 each
effect leaves the model as it is, on any of its meshes.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from calib import Effect, Parameter, StructuralModel
from calib.structure import (
    Addition,
    Assumption,
    Monomial,
    Place,
    SeriesLoss,
    Term,
    between,
    hung_masses,
    motion,
    outer_term,
    parameter,
    part_of,
    scaled_part,
)
from models.solar_panel import BEAM, E_BEAM, GAP, LENGTH, PLATE_DENSITY, THICKNESS, WIDTH

UZ, RX, RY = 2, 3, 4
"""Motions of a node that the array has: deflection, rotations about x and y."""
PANEL_HINGES = ((17, 13), (17, 16), (18, 15), (18, 18))
"""Beam and node of each hinge between the panels."""
YOKE_HINGES = ((19, 28), (20, 30))
CLAMP = 31
INSTRUMENT = (0.2, 0.0, 0.0)
HARNESS = (0.4, 0.0, 0.0)
HARNESS_RATIO = 0.05
CENTRES = ((LENGTH / 2, 0.0, 0.0), (LENGTH * 1.5 + GAP, 0.0, 0.0))
"""Of both panels: where the cords of the offloading rig hold them."""
CRACKED = ("plate 15", "plate 16")
"""The row of the rear panel beside the yoke."""

_REASON = "where such parts usually sit"


def solar_panel_effects() -> tuple[Effect, ...]:
    """Effects that may be missing in `models.solar_panel.solar_panel` with frames round its panels."""
    return (*_joint_effects(), *_added_effects(), *_test_effects())


def _joint_effects() -> tuple[Effect, ...]:
    """Hinges, root, latch, damper and a crack."""
    return (
        Effect(
            name="hinge_flexibility",
            title="Flexible hinges between the panels",
            phrase="the flexibility of the hinges between the panels",
            lacks="The beams between the panels turn rigidly with the panels' frames.",
            look_for="Play, thin lugs and springs of the hinges between the panels; turn one panel against the other.",
            magnitude=Parameter(
                "hinge_flexibility", 0.0, 0.0, 10.0, "rad/kNm", prior_sd=0.5,
                description="rotation about the hinge line per moment, in each of the four hinges",
            ),
            build=_hinge_flexibility,
        ),
        Effect(
            name="yoke_flexibility",
            title="Flexible hinges between the rear panel and the yoke",
            phrase="the flexibility of the hinges between the rear panel and the yoke",
            lacks="The yoke's arms turn rigidly with the rear panel's frame.",
            look_for="Play, thin lugs and springs of the two hinges at the yoke.",
            magnitude=Parameter(
                "yoke_flexibility", 0.0, 0.0, 10.0, "rad/kNm", prior_sd=0.5,
                description="rotation about the hinge line per moment, in each of the two hinges",
            ),
            build=_yoke_flexibility,
        ),
        Effect(
            name="root_flexibility",
            title="Flexible fittings of the yoke at the clamp",
            phrase="the flexibility of the yoke's fittings at the clamp",
            lacks="The clamp holds the yoke's arms rigidly.",
            look_for="Bolts, inserts and bearing of the drive at the root; measure the rotation of the clamp.",
            magnitude=Parameter(
                "root_flexibility", 0.0, 0.0, 10.0, "rad/kNm", prior_sd=0.5,
                description="rotation about the y axis per moment, in the fitting of each arm",
            ),
            build=_root_flexibility,
        ),
        Effect(
            name="locking_strut",
            title="A strut or latch that still joins the panels on the centre line",
            phrase="a strut that joins the panels on the centre line",
            lacks="Only the beams at both sides join the panels.",
            look_for="A hold-down, a latch or a cable that was not released between the panels.",
            magnitude=Parameter(
                "locking_strut", 0.0, 0.0, 5.0, "-", prior_sd=0.3,
                description="stiffness of the strut in bending and torsion over the nominal one of a beam",
            ),
            build=_locking_strut,
        ),
        Effect(
            name="hinge_damper",
            title="Dampers at the hinges between the panels",
            phrase="dampers at the hinges between the panels",
            lacks="The hinges have no damping of their own.",
            look_for="Eddy-current or viscous dampers of the deployment; friction of the hinges.",
            magnitude=Parameter(
                "hinge_damper", 0.0, 0.0, 50.0, "Nms/rad", prior_sd=2.0,
                description="rotational damping between the panels' edges, at either side",
            ),
            build=_hinge_damper,
        ),
        Effect(
            name="cracked_row",
            title="Cracked or delaminated rear panel beside the yoke",
            phrase="a crack or delamination of the rear panel beside the yoke",
            lacks="The rear panel bends with its full thickness up to the yoke.",
            look_for="Cracks, loose skins and a dull sound on tapping, in the last 0.2 m before the yoke.",
            magnitude=Parameter(
                "cracked_row", 0.0, 0.0, 0.95, "-", prior_sd=0.4,
                description="share of the bending stiffness lost in the last row of plates",
            ),
            build=_cracked_row,
        ),
    )  # fmt: skip


def _added_effects() -> tuple[Effect, ...]:
    """Masses on the panels."""
    return (
        Effect(
            name="instrument_mass",
            title="Unmodelled mass near the free end of the front panel",
            phrase="a mass near the free end of the front panel",
            lacks="The front panel carries nothing.",
            look_for="A sun sensor, a connector or a bracket on the centre line, 0.2 m from the free end.",
            magnitude=Parameter("instrument_mass", 0.0, 0.0, 5.0, "kg", prior_sd=0.3, description="mass of it"),
            build=_instrument_mass,
        ),
        Effect(
            name="hung_harness",
            title="Cabling hung elastically under the front panel",
            phrase="cabling hung elastically under the front panel",
            lacks="Everything on the panels moves rigidly with them.",
            look_for="A bundle of cables on soft clips under the middle of the front panel: touch it during a test.",
            magnitude=Parameter("hung_harness", 0.001, 0.001, 3.0, "kg", prior_sd=0.3, description="mass of it"),
            build=_hung_harness,
            nuisance=(
                Parameter(
                    "hung_harness_freq", 15.0, 4.0, 80.0, "Hz", prior_sd=12.0,
                    description="natural frequency of the bundle on its clips",
                ),
            ),
            grid=tuple({"hung_harness": 0.3, "hung_harness_freq": f} for f in (5.0, 7.0, 10.0, 14.0, 20.0, 28.0, 40.0)),
        ),
    )  # fmt: skip


def _test_effects() -> tuple[Effect, ...]:
    """What a test on the ground adds."""
    return (
        Effect(
            name="air_mass",
            title="Air that moves with the panels",
            phrase="the air that moves with the panels",
            lacks="The array moves in a vacuum.",
            look_for="Whether the test was made in air: a plate of 0.4 m width carries about 0.4 kg of it per m2.",
            magnitude=Parameter(
                "air_mass", 0.0, 0.0, 3.0, "kg/m2", prior_sd=0.4, description="mass of air per area of both panels"
            ),
            build=_air_mass,
        ),
        Effect(
            name="offload_cords",
            title="Cords of the rig that carries the panels' weight",
            phrase="the stiffness of the cords that carry the panels",
            lacks="The array hangs on its yoke alone.",
            look_for="The suspension of the offloading rig: pull a cord and measure how it gives way.",
            magnitude=Parameter(
                "offload_cords", 0.0, 0.0, 500.0, "N/m", prior_sd=10.0,
                description="stiffness to the ground at the centre of either panel",
            ),
            build=_offload_cords,
        ),
    )  # fmt: skip


# -- joints ------------------------------------------------------------------------------------------------------------


def _hinge_flexibility(model: StructuralModel) -> Addition:
    return Addition(stiffness=_hinges(model, "hinge_flexibility", PANEL_HINGES))


def _yoke_flexibility(model: StructuralModel) -> Addition:
    return Addition(stiffness=_hinges(model, "yoke_flexibility", YOKE_HINGES))


def _hinges(model: StructuralModel, name: str, hinges: tuple[tuple[int, int], ...]) -> tuple[Term, ...]:
    """Loss of the beams' stiffness by hinges about y at the nodes where they end."""
    turned: dict[int, list[np.ndarray]] = {}
    for number, node in hinges:
        turned.setdefault(number, []).append(motion(model, _place(model, node), RY))
    return tuple(term for number, rows in turned.items() for term in _softened(model, name, number, np.array(rows)))


def _root_flexibility(model: StructuralModel) -> Addition:
    """A fitting that turns by an angle moves its arm against the rest as a rigid body turned back by it would."""
    dofs, points = model.dofs, model.mesh.points
    behind = points[CLAMP - 1, 0] - points[dofs.node, 0]
    turned = np.where(dofs.direction == UZ, behind, np.where(dofs.direction == RY, 1.0, 0.0))
    both = [_softened(model, "root_flexibility", number, turned[None]) for number, _ in YOKE_HINGES]
    return Addition(stiffness=tuple(term for terms in both for term in terms))


def _softened(model: StructuralModel, name: str, number: int, turned: np.ndarray) -> tuple[Term, ...]:
    """Change of a beam's stiffness by one flexibility in series with the moment at each of some ends.

    With B the beam's stiffness for a Young's modulus E of 1 and T the rotations of these ends (n_ends, n_dof), the
    moments are ``E T B u``. A flexibility f in series with each leaves ``E B - E^2 B T^T (1/f + E T B T^T)^-1 T B``, a
    sum over the eigenvectors of ``T B T^T``. The rotary inertia beyond a hinge is neglected.
    """
    part = part_of(model, "stiffness", f"beam {number}")
    moments = turned @ part.matrix
    sizes, directions = np.linalg.eigh(moments @ turned.T)
    factor, powers = part.coefficient.factor, part.coefficient.powers
    return tuple(
        outer_term(
            f"{name}: {part.name}, {k}", [row / size], SeriesLoss(Monomial(size * factor, powers), parameter(name))
        )
        for k, (size, row) in enumerate(zip(sizes.tolist(), directions.T @ moments, strict=True))
    )


def _locking_strut(model: StructuralModel) -> Addition:
    """A square beam without mass between the edges: twice its energy is ``EI/L`` times three squares of its motions."""
    front, rear = _edges(0.0)
    deflection, slope = between(model, rear, front, UZ), [-motion(model, place, RY) for place in (front, rear)]
    twist = np.sqrt(BEAM.shear_modulus * BEAM.torsion / (BEAM.young_modulus * BEAM.i_y))
    rows = [
        slope[1] - slope[0],
        np.sqrt(12) * ((slope[0] + slope[1]) / 2 - deflection / GAP),
        twist * between(model, rear, front, RX),
    ]
    return Addition(stiffness=(outer_term("locking_strut", rows, parameter("locking_strut", strut_stiffness() / GAP)),))


def strut_stiffness() -> float:
    """Nominal bending stiffness of a beam, N m2."""
    return 1e9 * E_BEAM * BEAM.i_y


def _hinge_damper(model: StructuralModel) -> Addition:
    rows = [between(model, *_edges(y), RY) for y in (-WIDTH / 2, WIDTH / 2)]
    return Addition(damping=(outer_term("hinge_damper", rows, parameter("hinge_damper")),))


def _cracked_row(model: StructuralModel) -> Addition:
    return Addition(stiffness=tuple(scaled_part(model, "stiffness", name, "cracked_row", -1.0) for name in CRACKED))


# -- masses and the test -----------------------------------------------------------------------------------------------


def _instrument_mass(model: StructuralModel) -> Addition:
    return Addition(
        mass=(outer_term("instrument_mass", [motion(model, (None, INSTRUMENT), UZ)], parameter("instrument_mass")),),
        assumptions=(Assumption("mass on the front panel: x, y", f"{INSTRUMENT[0]}, {INSTRUMENT[1]}", "m", _REASON),),
    )


def _hung_harness(model: StructuralModel) -> Addition:
    row = motion(model, (None, HARNESS), UZ)
    hung = hung_masses([row], "hung_harness", "hung_harness_freq", HARNESS_RATIO)
    assumed = (
        Assumption("cabling: x, y", f"{HARNESS[0]}, {HARNESS[1]}", "m", _REASON),
        Assumption("cabling: damping ratio on its clips", f"{HARNESS_RATIO}", "-", "plastic clips"),
    )
    return Addition(hung.stiffness, hung.damping, hung.mass, hung.selected, hung.n_added, assumed)


def _air_mass(model: StructuralModel) -> Addition:
    plates = [p.matrix for p in model.parts if p.kind == "mass" and p.name.startswith("plate")]
    whole = sp.csr_array(sum(plates[1:], plates[0])) / (PLATE_DENSITY * THICKNESS)
    return Addition(mass=(Term("air_mass", sp.csr_array(whole), parameter("air_mass")),))


def _offload_cords(model: StructuralModel) -> Addition:
    rows = [motion(model, (None, centre), UZ) for centre in CENTRES]
    return Addition(stiffness=(outer_term("offload_cords", rows, parameter("offload_cords")),))


def _place(model: StructuralModel, node: int) -> Place:
    """Of one of the article's nodes."""
    x, y, z = model.mesh.points[node - 1].tolist()
    return None, (x, y, z)


def _edges(y: float) -> tuple[Place, Place]:
    """The edges of the front and of the rear panel that face each other, at one y."""
    return (None, (LENGTH, y, 0.0)), (None, (LENGTH + GAP, y, 0.0))
