"""Index arrays of sparse matrices: wrong ones are told as numbers, and never reach native code, here neither."""

import numpy as np
import pytest
import scipy.sparse as sp

from calib.errors.errors import InputError
from calib.structure import sparse_indices
from calib.structure.affine import AffineMatrix, Term
from calib.structure.geometry import DofMap
from calib.structure.model import StructuralModel
from calib.structure.sparse_indices import compressed_fault, coordinates_fault

INDPTR, INDICES = np.array([0, 1, 3, 4]), np.array([0, 1, 2, 2])


def test_arrays_of_a_matrix_are_taken():
    assert compressed_fault(INDPTR, INDICES, 4, 3, 3) is None
    assert compressed_fault(INDPTR.astype(np.int32), np.append(INDICES, 99), 5, 3, 3) is None  # behind the end
    assert compressed_fault(np.zeros(4, dtype=int), np.zeros(0, dtype=int), 0, 3, 3) is None
    assert coordinates_fault(INDICES, INDICES, 4, 3, 3) is None


@pytest.mark.parametrize(
    ("indptr", "indices", "entries", "told"),
    [
        (INDPTR, INDICES + 1, 4, ("index 3", "0 to 2", "subtract 1")),
        (INDPTR, INDICES - 1, 4, ("index -1",)),
        (INDPTR, [0, 1, 2, 2**40], 4, (f"index {2**40}",)),
        (INDPTR + 1, INDICES, 4, ("begins with 1",)),
        ([0, 3, 1, 4], INDICES, 4, ("falls from 3 to 1", "row 1")),
        ([0, 1, 3, 9], INDICES, 4, ("ends with 9", "4 indices")),
        (INDPTR, INDICES, 3, ("ends with 4", "3 entries")),
        ([0, 1, 4], INDICES, 4, ("3 entries", "3 rows")),
        (INDPTR, INDICES.astype(float), 4, ("indices", "float64")),
        (INDPTR, INDICES.reshape(2, 2), 4, ("indices", "(2, 2)")),
        (INDPTR.astype(object), INDICES, 4, ("indptr", "object")),
    ],
)
def test_arrays_that_contradict_each_other_are_told(indptr, indices, entries, told):
    fault = compressed_fault(np.asarray(indptr), np.asarray(indices), entries, 3, 3)
    assert fault is not None and all(part in " ".join(fault) for part in told)


@pytest.mark.parametrize(
    ("row", "column", "entries", "told"),
    [
        (INDICES + 1, INDICES + 1, 4, ("row 3", "subtract 1")),
        (INDICES, INDICES - 1, 4, ("column -1",)),
        (INDICES, INDICES[:3], 4, ("4 rows", "3 columns")),
        (INDICES, INDICES, 5, ("5 entries",)),
        (INDICES, INDICES.astype(float), 4, ("columns", "float64")),
    ],
)
def test_coordinates_outside_are_told(row, column, entries, told):
    fault = coordinates_fault(row, column, entries, 3, 3)
    assert fault is not None and all(part in " ".join(fault) for part in told)


class Arrays:
    """What a sparse matrix consists of, which no routine takes for one."""

    def __init__(self, form, shape, kind=float, **arrays):
        self.format, self.shape, self.dtype = form, shape, np.dtype(kind)
        vars(self).update({name: np.asarray(array) for name, array in arrays.items()})


@pytest.mark.parametrize(
    ("matrix", "told"),
    [
        (Arrays("csr", (3, 2), indptr=INDPTR, indices=INDICES, data=np.ones(4)), "index 2"),
        (Arrays("csc", (2, 3), indptr=INDPTR, indices=INDICES, data=np.ones(4)), "index 2"),
        (Arrays("bsr", (6, 4), indptr=INDPTR, indices=INDICES, data=np.ones((4, 2, 2))), "index 2"),
        (Arrays("coo", (3, 2), row=INDICES, col=INDICES, data=np.ones(4)), "column 2"),
        (Arrays("lil", (2, 2), rows=np.array([[0], [2]], dtype=object), data=np.array([[1.0], [1.0]])), "column 2"),
        (Arrays("csr", (3, 3), np.float16, indptr=INDPTR, indices=INDICES, data=np.ones(4)), "float16"),
        (Arrays("csr", (3, 3), object, indptr=INDPTR, indices=INDICES, data=np.ones(4)), "object"),
    ],
)
def test_every_format_is_checked(matrix, told):
    with pytest.raises(InputError, match=told):
        sparse_indices.require_consistent(matrix, "model")


@pytest.mark.parametrize("form", ["csr", "csc", "bsr", "coo", "lil", "dok", "dia"])
def test_a_sound_matrix_of_any_format_is_taken(form):
    sparse_indices.require_consistent(sp.eye_array(4).asformat(form), "model")


def _from_matrices(matrix):
    dofs = [(node, "x") for node in range(1, 4)]
    return StructuralModel.from_matrices(matrix, sp.eye_array(3), dofs=dofs)


@pytest.mark.parametrize(
    "door",
    [
        _from_matrices,
        lambda matrix: AffineMatrix(3, (Term("k", matrix),)),
        lambda matrix: DofMap(matrix, np.zeros(3, dtype=int), np.arange(3)),
    ],
)
def test_every_door_refuses_what_the_check_refuses(door, monkeypatch):
    """The check is made to refuse a sound matrix: none that it would have to refuse is given to anything else."""
    door(sp.csr_array(2.0 * sp.eye_array(3)))
    monkeypatch.setattr(sparse_indices, "compressed_fault", lambda *given: ("its index 3 is outside", "count from 0"))
    with pytest.raises(InputError, match="index 3"):
        door(sp.csr_array(2.0 * sp.eye_array(3)))
