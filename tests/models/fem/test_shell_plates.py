"""Natural frequencies of plates against closed forms and published values."""

import numpy as np
import pytest
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from models.fem.panel import sheet_panel
from models.fem.sheet import Sheet
from models.fem.structure import Structure

SHEET = Sheet(0.01, 70e9, 0.3, 2700.0)
ORTHOTROPIC = Sheet(
    0.01, 40e9, 0.25, 1500.0, young_modulus_across=8e9, shear_modulus=5e9, shear_modulus_through=(4e9, 3e9), rmi=30.0
)
A, B = 1.3, 1.0


def plate(sheet, n, a=A, b=B, refinement=0, along=None) -> Structure:
    x, y = np.linspace(0, a, n + 1), np.linspace(0, b, n + 1)
    panel = sheet_panel("b", "g", sheet, x, [(v, 0.0) for v in y], refinement=refinement, along=along)
    return Structure((), panels=(panel,))


def frequencies(s: Structure, held: list[int], count: int) -> np.ndarray:
    """Lowest natural frequencies in Hz with motions 0, 1 and 5 held everywhere and the given ones besides."""
    every = np.arange(len(s.points))
    held = np.unique(np.concatenate([6 * every + d for d in (0, 1, 5)] + [np.array(held, dtype=int)]))
    free = np.setdiff1d(np.arange(s.n_full), held)
    shells = s.shells()
    k = sp.csc_matrix(shells.stiffness[free][:, free])
    m = sp.csc_matrix(sp.csr_array(shells.mass + shells.rotary)[free][:, free])
    shift = -1e-4 * k.diagonal().max() / m.diagonal().max()
    squares = spla.eigsh(k, count, m, sigma=shift, return_eigenvectors=False, v0=np.ones(len(free)))
    return np.sqrt(np.maximum(np.sort(squares), 0.0)) / (2 * np.pi)


def border(s: Structure, x: float | None = None, y: float | None = None) -> np.ndarray:
    axis, value = (0, x) if x is not None else (1, y)
    return np.flatnonzero(np.abs(s.points[:, axis] - value) < 1e-9)


def simply_supported(s: Structure, a=A, b=B) -> list[int]:
    """Deflection and rotation along the edge are held: what the closed form of shear-flexible plates supposes."""
    held = []
    for nodes, along in ((border(s, x=0.0), 3), (border(s, x=a), 3), (border(s, y=0.0), 4), (border(s, y=b), 4)):
        held += [6 * i + d for i in nodes for d in (2, along)]
    return held


def closed_form(sheet: Sheet, orders: int, a=A, b=B) -> np.ndarray:
    """Simply supported shear-flexible orthotropic plate with rotary inertia (Mindlin 1951): waves m, n in Hz."""
    found = []
    heavy = sheet.density * sheet.thickness
    mass = heavy * np.array([1.0, sheet.thickness**2 / 12, sheet.thickness**2 / 12])
    for p in np.pi / a * np.arange(1, orders):
        for q in np.pi / b * np.arange(1, orders):
            bending = np.array([[0, -p, 0], [0, 0, -q], [0, q, p]])
            shear = np.array([[p, 1, 0], [q, 0, 1]])
            k = bending.T @ sheet.bending @ bending + shear.T @ sheet.shear @ shear
            found.append(np.sqrt(np.linalg.eigvals(k / mass[:, None]).real.min()) / (2 * np.pi))
    return np.sort(found)


@pytest.mark.parametrize("sheet", [SHEET, Sheet(0.15, 70e9, 0.3, 2700.0), ORTHOTROPIC], ids=["thin", "thick", "ortho"])
def test_simply_supported_plates_converge_with_the_square_of_the_size(sheet):
    exact = closed_form(sheet, 6)[:3]
    error = []
    for n in (8, 16):
        s = plate(sheet, n)
        error.append(frequencies(s, simply_supported(s), 3) / exact - 1)
    assert np.abs(error[0][0]) < 0.03 and np.abs(error[1]).max() < 0.06
    rate = np.log2(np.abs(error[0] / error[1]))
    assert np.all(rate > 1.9) and np.all(rate < 2.2)


def test_thin_plate_reaches_kirchhoff():
    thin = Sheet(1e-3, 70e9, 0.3, 2700.0)
    assert closed_form(thin, 3)[0] == pytest.approx(
        np.pi / 2 * (1 / A**2 + 1 / B**2) * np.sqrt(thin.bending[0, 0] / (2700.0 * 1e-3)), rel=1e-4
    )
    s = plate(thin, 16)
    np.testing.assert_allclose(frequencies(s, simply_supported(s), 1), closed_form(thin, 3)[0], rtol=0.005)


def test_direction_of_an_orthotropic_sheet_is_the_given_one():
    # Turning the material by a right angle is exchanging the sides.
    turned = plate(ORTHOTROPIC, 8, B, A, along=(0.0, 1.0, 0.0))
    straight = plate(ORTHOTROPIC, 8)
    here = frequencies(straight, simply_supported(straight), 4)
    np.testing.assert_allclose(frequencies(turned, simply_supported(turned, B, A), 4), here, rtol=1e-9)
    other = plate(ORTHOTROPIC, 8, B, A)
    assert frequencies(other, simply_supported(other, B, A), 1)[0] != pytest.approx(here[0], rel=0.05)


# Frequency parameters omega a^2 sqrt(rho h / D) of thin square plates, nu = 0.3 (Leissa 1973). They are Ritz values and
# so upper bounds, which explains up to 1 %.
LEISSA = {
    "cantilever": [3.4917, 8.5246, 21.429, 27.331, 31.111, 54.443],
    "clamped": [35.992, 73.413, 73.413, 108.27, 131.64, 132.24],
    "free": [13.489, 19.789, 24.432, 35.024, 35.024, 61.526],
}


def parameters(case: str, n: int) -> np.ndarray:
    sheet = Sheet(1e-3, 70e9, 0.3, 2700.0)
    s = plate(sheet, n, 1.0, 1.0)
    where = {"cantilever": [border(s, x=0.0)], "free": []}.get(
        case, [border(s, x=0.0), border(s, x=1.0), border(s, y=0.0), border(s, y=1.0)]
    )
    held = [6 * i + d for nodes in where for i in nodes for d in (2, 3, 4)]
    rigid = 3 if case == "free" else 0
    freq = frequencies(s, held, 6 + rigid)
    assert np.all(freq[:rigid] < 1e-3 * freq[rigid])
    return 2 * np.pi * freq[rigid:] * np.sqrt(2700.0 * 1e-3 / sheet.bending[0, 0])


@pytest.mark.medium
@pytest.mark.parametrize("case", [pytest.param(c, marks=[pytest.mark.slow] * (c == "free")) for c in LEISSA])
def test_square_plates_agree_with_leissa(case):
    coarse, fine = parameters(case, 12), parameters(case, 24)
    extrapolated = (4 * fine - coarse) / 3
    deviation = extrapolated / LEISSA[case] - 1
    assert np.all(deviation < 0.002) and np.all(deviation > -0.011), deviation
    np.testing.assert_allclose(fine, extrapolated, rtol=0.03)
