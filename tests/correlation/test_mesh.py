import numpy as np

from calib.correlation.mesh_error import elements_table, points_table
from calib.structure.geometry import Mesh

POINTS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 2, 0]], dtype=float)
LINES = np.array([[3, 4], [0, 1], [1, 2], [2, 3], [3, 0]])
MESH = Mesh(POINTS, LINES, ("mast", "wall", "wall", "sill", "wall"), np.array([[0, 1, 2, 3]]), ("wall",))


def test_points_are_numbered_as_the_elements_name_them():
    table = points_table(MESH)
    np.testing.assert_array_equal(table[["x", "y", "z"]], POINTS)
    assert table["point"].tolist() == [0, 1, 2, 3, 4]


def test_edges_of_faces_are_omitted_and_members_are_listed():
    text = elements_table(MESH).to_csv(index=False)
    assert text.splitlines() == ["group,a,b,c,d", "mast,3,4,,", "sill,2,3,,", "wall,0,1,2,3"]


def test_a_model_of_lines_has_no_faces():
    table = elements_table(Mesh(POINTS, LINES, ("bar",) * 5))
    np.testing.assert_array_equal(table[["a", "b"]].to_numpy(dtype=int), LINES)
    assert table[["c", "d"]].isna().all(axis=None)


def test_points_without_coordinates_are_omitted():
    points = POINTS.copy()
    points[4] = np.nan
    mesh = Mesh(points, LINES, MESH.groups, MESH.faces, MESH.face_groups)
    assert points_table(mesh)["point"].tolist() == [0, 1, 2, 3]
    assert elements_table(mesh)["group"].tolist() == ["sill", "wall"]
    assert points_table(Mesh(points * np.nan, LINES, MESH.groups)).empty
