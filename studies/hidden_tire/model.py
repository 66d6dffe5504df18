"""The tire of this study: a coarse mesh, corrected by a finer one at the nominal values (``mesh.csv``)."""

from pathlib import Path

from calib import FunctionModel
from models.tire.mesh_correction import mesh_corrected, mesh_factors, read_factors
from models.tire.model import tire_on_ground

HERE = Path(__file__).resolve().parent
COARSE, FINE = (29, 16), (49, 32)
DEFLECTIONS, ORDERS = (5.0, 10.0, 15.0, 20.0), (0, 1, 2, 3, 4)
PRESSURES = (100.0, 150.0, 200.0, 300.0)


def tire(corrected: bool = True) -> FunctionModel:
    """The tire on the ground, at four deflections, with five hoop orders: the corrected mesh, or the finer one itself.

    The two agree at the nominal values; elsewhere they differ by what the correction leaves of the coarse mesh's error.
    """
    if not corrected:
        return tire_on_ground(*FINE, DEFLECTIONS, (), ORDERS)
    return mesh_corrected(tire_on_ground(*COARSE, DEFLECTIONS, (), ORDERS), read_factors(HERE / "mesh.csv"))


def main() -> None:
    """Write ``mesh.csv`` anew: python studies/hidden_tire/model.py."""
    coarse, fine = (tire_on_ground(*mesh, DEFLECTIONS, (), ORDERS, derivatives=False) for mesh in (COARSE, FINE))
    table = mesh_factors(coarse, fine, PRESSURES)
    head = f"# responses of {FINE[0]} x {FINE[1]} cells over those of {COARSE[0]} x {COARSE[1]}, pressure in kPa\n"
    (HERE / "mesh.csv").write_text(head + table.to_csv(float_format="%.6g"), encoding="utf-8")


if __name__ == "__main__":
    main()
