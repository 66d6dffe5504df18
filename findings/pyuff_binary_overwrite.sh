#!/usr/bin/env bash
# pyuff 2.5.8, one frequency response function written as binary dataset 58 into a new file, with mode "overwrite".
# Expected: a file with the dataset, as with mode "add", and as mode "overwrite" writes the text form.
# Seen:     a file of 7 bytes that holds a single delimiter and no dataset, without an error; Python notes an unclosed file, in both modes.
# Meaning:  measurements that were exported in this way are lost. Write binary functions with mode "add" into a new file.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/python" -m pip install --quiet --disable-pip-version-check pyuff==2.5.8 numpy==2.4.6
"$folder/env/bin/python" - "$folder" <<'END'
import sys
import warnings
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pyuff

axes = {
    f"{axis}_{key}": value
    for axis in ("abscissa", "ordinate", "orddenom", "z_axis")
    for key, value in {
        "spec_data_type": 0, "len_unit_exp": 0, "force_unit_exp": 0, "temp_unit_exp": 0, "axis_lab": "NONE",
        "axis_units_lab": "NONE",
    }.items()
}
function = axes | {
    "type": 58, "id1": "receptance", "id2": "NONE", "id3": "NONE", "id4": "NONE", "id5": "NONE", "func_type": 4,
    "func_id": 1, "ver_num": 0, "load_case_id": 0, "rsp_ent_name": "NONE", "rsp_node": 1, "rsp_dir": 1,
    "ref_ent_name": "NONE", "ref_node": 1, "ref_dir": 1, "data": np.array([1 + 1j, 2 + 0j, 3 + 0j, 4j]),
    "x": np.arange(4.0), "abscissa_spacing": 1, "abscissa_min": 0.0, "abscissa_inc": 1.0, "z_axis_value": 0.0,
    "abscissa_spec_data_type": 18,
}
seen = {}
with warnings.catch_warnings(record=True) as told:
    warnings.simplefilter("always")
    for binary in (0, 1):
        for mode in ("overwrite", "add"):
            file = Path(sys.argv[1]) / f"{binary}_{mode}.uff"
            pyuff.UFF(str(file)).write_sets(function | {"binary": binary}, mode)
            seen[binary, mode] = file.stat().st_size, [int(kind) for kind in pyuff.UFF(str(file)).get_set_types()]
print(f"pyuff {version('pyuff')}; warnings: {sorted({one.category.__name__ for one in told})}; binary, mode: bytes, datasets")
print("\n".join(f"{binary}, {mode}: {size}, {kinds}" for (binary, mode), (size, kinds) in seen.items()))
written = all(kinds == [58] for key, (_, kinds) in seen.items() if key != (1, "overwrite"))
as_stated = written and seen[1, "overwrite"] == (7, [])
sys.exit(None if as_stated else "The behaviour has changed: see above.")
END
