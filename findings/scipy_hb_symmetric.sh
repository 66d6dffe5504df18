#!/usr/bin/env bash
# SciPy 1.17.1, a symmetric matrix in a Harwell-Boeing file (type RSA), as finite-element codes write stiffness and mass.
# Expected: scipy.io.hb_read reads it, as it reads the files that scipy.io.hb_write has written.
# Seen:     ValueError (only unsymmetric types are supported); hb_write writes the same matrix in full as RUA, so that the pair never shows it.
# Meaning:  exports of stiffness matrices need another reader, or have to be converted first.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/python" -m pip install --quiet --disable-pip-version-check scipy==1.17.1 numpy==2.4.6
"$folder/env/bin/python" - "$folder" <<'END'
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from scipy.io import hb_read, hb_write

home, stiffness = Path(sys.argv[1]), np.array([[2.0, -1.0], [-1.0, 2.0]])
hb_write(str(home / "own.hb"), sp.csc_matrix(stiffness))
own = (home / "own.hb").read_text().splitlines()[2][:3]
symmetric = "\n".join([
    f"{'two springs':72}{'KEY':8}", "".join(f"{n:14d}" for n in (3, 1, 1, 1, 0)), f"{'RSA':14}" + "".join(f"{n:14d}" for n in (2, 2, 3, 0)),
    f"{'(10I8)':16}{'(10I8)':16}{'(4E20.12)':20}{'':20}", "".join(f"{n:8d}" for n in (1, 3, 4)), "".join(f"{n:8d}" for n in (1, 2, 2)),
    "".join(f"{v:20.12E}" for v in (2.0, -1.0, 2.0)), "",
])
(home / "symmetric.hb").write_text(symmetric)
try:
    seen = f"read as {hb_read(str(home / 'symmetric.hb')).toarray().tolist()}"
except ValueError as fault:
    seen = f"ValueError: {fault}"
back = hb_read(str(home / "own.hb")).toarray()
print(f"SciPy {version('scipy')}; RSA: {seen}\nhb_write wrote {own}, read back as {back.tolist()}")
as_stated = seen.startswith("ValueError") and own == "RUA" and np.array_equal(back, stiffness)
sys.exit(None if as_stated else "The behaviour has changed: see above.")
END
