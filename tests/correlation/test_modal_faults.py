"""Faults of a modal measurement: what they do to readings, and their derivatives against differences."""

import dataclasses

import numpy as np
import pytest

from calib.correlation.modal.fault_library import gain_words, modal_faults
from calib.correlation.modal.faulty_modes import FaultyModes
from calib.correlation.modal.problem import ModalProblem
from calib.correlation.modal.residual import ModalResidual

TRUTH = {"k_along": 52.0, "k_across": 9.0, "c_end": 800.0, "mass": 11.0}
AWAY = {"k_along": 51.6, "k_across": 9.05, "c_end": 820.0, "mass": 10.95}


@pytest.fixture
def faulty(build, twin):
    """Complex and real shapes of one structure, with every fault that its test may have."""

    def make(real=False):
        model = build(damped=True)
        measured = twin(model, TRUTH, real=real)
        faults = modal_faults(model, measured, {"first": [s.name for s in measured.sensors[:5]]})
        return ModalResidual(ModalProblem(model, measured, mode_count=8), faults=faults)

    return make


def sized(residual, name, part=0.3):
    return part * next(f.plausible for f in residual.faults if f.name == name)


def one_of_each(residual):
    return {f.kind + (f.name if f.kind == "damping" else ""): f.name for f in residual.faults}


def test_without_a_fault_the_residual_is_the_plain_one(faulty):
    residual = faulty()
    plain = ModalResidual(residual.problem)
    np.testing.assert_array_equal(residual.residual(AWAY), plain.residual(AWAY))
    names = ("k_along", "mass")
    np.testing.assert_array_equal(residual.jacobian(AWAY, names), plain.jacobian(AWAY, names))


def test_all_kinds_are_there(faulty):
    kinds = {f.kind for f in faulty().faults}
    assert kinds == {
        "gain", "delay", "rotation", "place", "cross-talk", "exchange", "axes", "mixed", "set-up", "damping"
    }  # fmt: skip
    assert {f.kind for f in faulty(real=True).faults} - kinds == {"modulus"}
    assert len({f.name for f in faulty().faults}) == len(faulty().faults)


@pytest.mark.medium
@pytest.mark.mostly_slow(1)
@pytest.mark.parametrize("real", [False, True])
def test_gradient_is_exact(faulty, real):
    """The gradient of the sum of squares is exact although the Jacobian is projected (Kaufman 1975)."""
    residual = faulty(real)
    for name in one_of_each(residual).values():
        here = {**AWAY, name: sized(residual, name)}
        names = ("c_end", name)
        gradient = residual.residual(here) @ residual.jacobian(here, names)
        for k, one in enumerate(names):
            half = 1e-5 * here[one]
            up, down = (residual.residual({**here, one: here[one] + s * half}) for s in (1, -1))
            numeric = (up @ up - down @ down) / (4 * half)
            assert gradient[k] == pytest.approx(numeric, rel=2e-4, abs=1e-4 * np.linalg.norm(up)), (name, one)


def test_derivatives_at_full_agreement(faulty):
    """Where nothing is left, the projected Jacobian is the derivative itself."""
    residual = faulty()
    for name in one_of_each(residual).values():
        half = 1e-5 * sized(residual, name, 1.0)
        at = {**TRUTH, name: 0.0}
        up, down = (residual.residual({**TRUTH, name: s * half}) for s in (1, -1))
        slope = residual.jacobian(at, [name])[:, 0]
        numeric = (up - down) / (2 * half)
        assert np.linalg.norm(slope) > 0, name
        np.testing.assert_allclose(slope, numeric, atol=1e-4 * np.abs(numeric).max(), err_msg=name)


def read(residual, name, magnitude):
    """What the measurement would be with a fault of the structure at the truth, in the shape of the measured shapes."""
    found = residual.solve({**TRUTH, name: magnitude})
    modes, partner = FaultyModes(residual.problem, residual.faults), found.pairing.model_index
    return np.column_stack([modes.reading(found, i, int(partner[i])) for i in found.pairing.paired])


def test_readings_are_what_the_faults_say(faulty):
    residual = faulty()
    measured = residual.problem.measured
    names = [s.name for s in measured.sensors]
    sound = read(residual, "gain of sensor 1x", 0.0)
    low = read(residual, f"gain of sensor {names[3]}", -0.1)
    np.testing.assert_allclose(low[3], 0.9 * sound[3])
    np.testing.assert_allclose(np.delete(low, 3, 0), np.delete(sound, 3, 0))
    late = read(residual, f"delay of sensor {names[3]}", 2.0)
    np.testing.assert_allclose(late[3], sound[3] * np.exp(-2j * np.pi * measured.natural_freq * 2e-3))
    mixed = read(residual, f"cross-talk of sensor {names[4]} into {names[3]}", 0.05)
    np.testing.assert_allclose(mixed[3], sound[3] + 0.05 * sound[4])
    joined = read(residual, "factor of set-up first", 0.2)
    np.testing.assert_allclose(joined, sound * np.where(np.arange(len(names)) < 5, 1.2, 1.0)[:, None])
    node = measured.sensors[3].node
    for f in residual.faults:
        if f.kind == "rotation" and f.sensor == names[3]:
            other = names.index(f"{node}{f.name[-1]}") if f"{node}{f.name[-1]}" in names else None
            turned = read(residual, f.name, 10.0)
            if other is not None:
                angle = np.radians(10.0)
                np.testing.assert_allclose(turned[3], np.cos(angle) * sound[3] + np.sin(angle) * sound[other])


def test_pairs_of_channels_are_read_as_their_faults_say(faulty):
    residual = faulty()
    measured = residual.problem.measured
    names = [s.name for s in measured.sensors]
    sound = read(residual, "gain of sensor 1x", 0.0)
    exchanged = read(residual, f"exchange of sensors {names[1]} and {names[6]}", 1.0)
    order = [1, 6]
    np.testing.assert_allclose(exchanged[order], sound[order[::-1]])
    np.testing.assert_allclose(np.delete(exchanged, order, 0), np.delete(sound, order, 0))
    far = read(residual, f"cross-talk of sensor {names[7]} into {names[1]}", 0.2)
    np.testing.assert_allclose(far[1], sound[1] + 0.2 * sound[7])
    for one in [f for f in residual.faults if f.kind == "axes"][:2]:
        x, y = (names.index(name) for name in one.sensor.split())
        sign = 1.0 if one.name.endswith(f"{names[y]} reversed") else -1.0
        turned = read(residual, one.name, 1.0)
        np.testing.assert_allclose(turned[x], sign * sound[y], atol=1e-9 * np.abs(sound).max())
        np.testing.assert_allclose(turned[y], -sign * sound[x], atol=1e-9 * np.abs(sound).max())
        minus = ("", "-") if sign > 0 else ("-", "")
        words = f"sensor {names[x]} measures along {minus[0]}y and {names[y]} along {minus[1]}x"
        assert one.told(1.0) == words


def test_every_pair_is_a_candidate_once(faulty):
    residual = faulty()
    n = len(residual.problem.measured.sensors)
    pairs = [f for f in residual.faults if f.of_pair]
    number = {kind: sum(f.kind == kind for f in pairs) for kind in ("exchange", "cross-talk", "axes")}
    nodes = len({s.node for s in residual.problem.measured.sensors})
    assert number == {"exchange": n * (n - 1) // 2, "cross-talk": n * (n - 1) - 2 * (n - 1), "axes": 2 * nodes}
    single = [f for f in residual.faults if not f.of_pair]
    assert {f.kind for f in single} == {"gain", "delay", "rotation", "place", "cross-talk", "set-up", "damping"}


@pytest.mark.parametrize("real", [False, True])
def test_a_mixed_shape_agrees_with_its_share(faulty, real):
    """Magnitude is the share over the size of the measured shape; frequencies may not be far apart."""
    residual = faulty(real)
    measured = residual.problem.measured
    one = next(f for f in residual.faults if f.kind == "mixed")
    i, j = (measured.names.index(mode) for mode in one.mixed[:2])
    freq = measured.natural_freq
    assert abs(freq[i] - freq[j]) < 0.2 * freq[[i, j]].mean()
    every = {f.mixed[:2] for f in residual.faults if f.kind == "mixed"}
    assert all((b, a) in every for a, b in every) and len(every) < 2 * (len(freq) - 1)
    shapes = measured.shapes.copy()
    own, other = measured.shapes[:, i], measured.shapes[:, j]
    turn = np.exp(0.5j * (np.angle(np.sum(own**2)) - np.angle(np.sum(other**2))))
    shapes[:, i] = own + 0.3 * turn * other * np.linalg.norm(own) / np.linalg.norm(other)
    mixed = dataclasses.replace(measured, shapes=shapes)
    wrong = dataclasses.replace(residual, problem=dataclasses.replace(residual.problem, measured=mixed))
    share = 0.3 * np.linalg.norm(own) / np.linalg.norm(shapes[:, i])
    of_mode = np.array([row.mode == measured.names[i] and row.kind == "shape" for row in wrong.rows])
    assert np.abs(wrong.residual(TRUTH)[of_mode]).max() > 5
    signs = [np.abs(wrong.residual({**TRUTH, one.name: s * share})[of_mode]).max() for s in (1, -1)]
    sound = np.abs(residual.residual(TRUTH)[of_mode]).max()
    assert min(signs) < 1.1 * sound + 0.02 * max(signs)  # the phase that is most real is that of the mixture


def test_a_shift_follows_the_gradient_to_the_next_nodes(faulty):
    residual = faulty()
    model, measured = residual.problem.model, residual.problem.measured
    one = next(f for f in residual.faults if f.kind == "place")
    k = next(i for i, s in enumerate(measured.sensors) if s.name == one.sensor)
    first, last = (next(s for s in one.shares if s.factor * sign > 0).source for sign in (-1, 1))
    found = residual.solve(TRUTH)
    motion = model.sensor_rows([first, last]) @ found.modes.shapes
    gap = np.linalg.norm(np.subtract(last.point, first.point))
    index = found.pairing.model_index
    expected = found.sensor_shapes[k] + 0.02 * (motion[1] - motion[0]) / gap
    np.testing.assert_allclose(read(residual, one.name, 20.0)[k], expected[index])


def test_damping_of_the_analysis_is_added_to_the_ratios(faulty):
    residual = faulty()
    freq = residual.problem.measured.natural_freq
    damped = residual.kinds == "damping"
    sound = residual.problem.measured.damping_ratio
    middle = np.exp(np.mean(np.log(freq)))
    for name, pattern in (
        ("damping added to all modes", np.ones(len(freq))),
        ("damping added in proportion to M", middle / freq),
        ("damping added in proportion to K", freq / middle),
    ):
        ratio = sound * np.exp(-residual.residual({**TRUTH, name: 0.003})[damped] * residual.std.damping)
        np.testing.assert_allclose(ratio, sound + 0.003 * pattern, rtol=1e-6)


def test_moduli_with_a_sign_are_recognised(faulty, build, twin):
    """Real shapes that are moduli of complex ones agree exactly with magnitude 1, and only there."""
    model = build(damped=True)
    shapes = twin(model, TRUTH).shapes
    turned = shapes * np.exp(-0.5j * np.angle(np.sum(shapes**2, axis=0)))
    signed = np.copysign(np.abs(turned), turned.real)
    measured = dataclasses.replace(twin(model, TRUTH, real=True), shapes=signed.astype(complex))
    name = "shapes given as amplitude and sign"
    residual = ModalResidual(ModalProblem(model, measured, mode_count=8), faults=modal_faults(model, measured))
    left = {q: np.linalg.norm(residual.residual({**TRUTH, name: q})) for q in (0.0, 0.5, 1.0)}
    assert left[1.0] < 1e-5 and left[0.0] > left[0.5] > 0.1


@pytest.mark.parametrize(
    ("by", "words"),
    [
        (-0.1, "it reads 10 % low"),
        (0.05, "it reads 5 % high"),
        (-2.0, "it has the wrong sign"),
        (-1.0, "it reads next to nothing"),
        (-1.8, "it has the wrong sign, and 20 % low"),
    ],
)
def test_gains_in_words(by, words):
    assert gain_words("it", by) == words
