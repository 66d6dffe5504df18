#!/usr/bin/env bash
# SALib 1.6.0, Sobol indices of a model that failed at one point.
# Expected: NaN, an error, or at least a warning.
# Seen:     all first-order and total indices are exactly 0, without a warning, although the second input explains 80 % of the variance.
# Meaning:  whoever marks failed evaluations by NaN reads that no parameter matters. Remove the failed points' groups first.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/python" -m pip install --quiet --disable-pip-version-check \
    SALib==1.6.0 numpy==2.4.6 scipy==1.17.1 pandas==3.1.1
"$folder/env/bin/python" - <<'END'
import sys
import warnings
from importlib.metadata import version

import numpy as np
from SALib.analyze import sobol
from SALib.sample import sobol as samples

problem = {"num_vars": 2, "names": ["a", "b"], "bounds": [[0, 1], [0, 1]]}
points = samples.sample(problem, 64, seed=1)
outputs = points[:, 0] + 2 * points[:, 1]
sound = sobol.analyze(problem, outputs, seed=1)
outputs[5] = np.nan
with warnings.catch_warnings(record=True) as told:
    warnings.simplefilter("always")
    found = sobol.analyze(problem, outputs, seed=1)
print(f"SALib {version('SALib')}, one of {len(outputs)} outputs NaN; {len(told)} warnings")
for kind in ("S1", "ST"):
    print(f"{kind}: {sound[kind].round(3)} without NaN, {found[kind]} with it")
as_stated = not told and all((found[kind] == 0.0).all() for kind in ("S1", "ST")) and sound["S1"][1] > 0.7
sys.exit(None if as_stated else "The behaviour has changed: see above.")
END
