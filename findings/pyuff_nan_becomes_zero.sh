#!/usr/bin/env bash
# pyuff 2.5.8, a frequency response function whose first line is undefined (NaN), as an estimate of H1 is at 0 Hz.
# Expected: the line comes back as NaN, or writing refuses it.
# Seen:     it is written and read back as 0, without a warning, in the text form of dataset 58.
# Meaning:  a line that was not measured looks like a measured response of exactly 0. Leave such lines out before writing.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/python" -m pip install --quiet --disable-pip-version-check pyuff==2.5.8 numpy==2.4.6
"$folder/env/bin/python" - "$folder/one.uff" <<'END'
import sys
import warnings
from importlib.metadata import version

import numpy as np
import pyuff

lines = np.array([np.nan, 1 + 1j, 2 + 0j, 3 + 0j])
axes = {
    f"{axis}_{key}": value
    for axis in ("abscissa", "ordinate", "orddenom", "z_axis")
    for key, value in {
        "spec_data_type": 0, "len_unit_exp": 0, "force_unit_exp": 0, "temp_unit_exp": 0, "axis_lab": "NONE",
        "axis_units_lab": "NONE",
    }.items()
}
function = axes | {
    "type": 58, "binary": 0, "id1": "receptance", "id2": "NONE", "id3": "NONE", "id4": "NONE", "id5": "NONE",
    "func_type": 4, "func_id": 1, "ver_num": 0, "load_case_id": 0, "rsp_ent_name": "NONE", "rsp_node": 1, "rsp_dir": 1,
    "ref_ent_name": "NONE", "ref_node": 1, "ref_dir": 1, "data": lines, "x": np.arange(4.0), "abscissa_spacing": 1,
    "abscissa_min": 0.0, "abscissa_inc": 1.0, "z_axis_value": 0.0, "abscissa_spec_data_type": 18,
}
with warnings.catch_warnings(record=True) as told:
    warnings.simplefilter("always")
    pyuff.UFF(sys.argv[1]).write_sets(function, "overwrite")
    back = pyuff.UFF(sys.argv[1]).read_sets()["data"]
print(f"pyuff {version('pyuff')}; {len(told)} warnings\nwritten: {lines}\nread:    {back}")
as_stated = not told and back[0] == 0 and np.allclose(back[1:], lines[1:])
sys.exit(None if as_stated else "The behaviour has changed: see above.")
END
