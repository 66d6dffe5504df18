"""Numbers at the top of modules: those that decide a verdict stand in the rules, which every record holds.

What is left is listed here by its reason, file by file. A new one that decides between verdicts, or that stands for
something unknown, belongs into the rules of its subject (`calib.analyses.provenance.state`).
"""

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1] / "calib"

FOLDERS = {
    "report": "layout of figures and pages, which read tables; levels of verdicts are checked against the rules",
    "command": "how many lines are printed",
    "results/ledger": "format and access of the database",
    "workbench": "patience of the live page and lengths of its lists; it decides nothing",
}

ROUNDING = {  # tolerances of arithmetic, far below what any verdict tells apart
    "hypotheses/linear_start.py": "_INDEPENDENT",
    "analyses/staged.py": "_ROUNDING",
    "analyses/refine.py": "_TINY",
    "analyses/provenance/stored.py": "SAME PART_OF_STD",
    "correlation/modal/fault_library.py": "NEGLIGIBLE",
    "correlation/frf/places.py": "_ROUNDING",
    "structure/eigenproblem/mode_tracking.py": "_SAME_PLACE",
    "correlation/modal/problem.py": "_LEAST_FREQ",
    "correlation/modal/residual.py": "_LEAST_RATIO",
    "problem/degrees_of_freedom.py": "KNOWN _ZERO",
    "problem/prior.py": "_LEAST _SAME",
    "inference/cmcf_equations.py": "RESONANT _RANK",
    "inference/constraints.py": "_EXACT",
    "inference/linear_estimate.py": "_NEGLIGIBLE",
    "inference/identify.py": "_ZERO",
    "inference/freed.py": "_FAR",
    "inference/region.py": "ACTIVE",
    "measurement/mac.py": "_COLLINEAR",
    "correlation/modal/sensors.py": "_ROUNDING",
    "measurement/frf_repeats.py": "_AXIS _ROUNDED",
    "measurement/files/uff_nodes.py": "_ON_AXIS",
    "measurement/frf_units.py": "SAME_UNIT",
    "measurement/partners.py": "_COINCIDE",
    "measurement/places.py": "REPEAT_TOLERANCE TABLE_TOLERANCE UNIT_TOLERANCE",
    "measurement/record.py": "DIGITS GAP UNEVEN SAME_RATE",
    "missing/granted.py": "_SPENT",
    "missing/recommendation.py": "_ROUNDING",
    "missing/score.py": "_NEVER",
    "missing/suspect.py": "_SINGULAR",
    "sensitivity/partial.py": "OWN_PART",
    "sensitivity/polynomials.py": "_OWN",
    "structure/eigenproblem/deflation.py": "_CLEAR _CONVERGED _SAME",
    "structure/eigenproblem/derivatives.py": "_BESIDE",
    "structure/eigenproblem/known_modes.py": "CONVERGED _CLEAR",
    "structure/eigenproblem/mode_systems.py": "NEIGHBOUR REPEATED _FREE",
    "structure/effect_places.py": "_LITTLE",
    "structure/eigenproblem/eigenvalues.py": "_REAL _ZERO",
    "structure/energy.py": "_ZERO_ENERGY",
    "structure/expansion.py": "_ALIKE",
    "structure/frf.py": "_RANK _NEAR_RESONANCE _SINGULAR _THRESHOLD _BACKWARD",
    "structure/eigenproblem/inertia.py": "_BACKWARD _RESIDUAL",
    "structure/matrices.py": "_ROUNDING",
    "imports/runs.py": "WIDE _WRITTEN _NOTHING",
    "api/fe_runs.py": "_FRESH _NODES",
    "study/solver.py": "MODES STEP _KEPT _NOTED _TOLD",
    "structure/places.py": "_LITTLE _STRAIGHT",
    "structure/effects/point_compositions.py": "_ROUNDED _SAME",
    "structure/reduction/refinement.py": "_ALONG ACCURACY _CLEAR _ORTHOGONAL _SHIFT",
    "structure/eigenproblem/solve.py": "_COPY _RIGID _ROUNDINGS _SHIFT _TURNING",
    "structure/eigenproblem/solve_dense.py": "_SHIFT",
    "structure/elongations.py": "_ELASTIC _ROUNDED",
    "structure/mounted.py": "_AT_POINT",
    "structure/null_space.py": "_SHIFT _MORE",
    "structure/soundness.py": "_ROUNDING",
    "structure/reduction/static_reduction.py": "_SINGULAR _ALIKE",
}

ACCURACY = {  # of solutions, reduced bases and differences, which are checked against full order
    "analyses/reduction.py": "FIRST_ORDER",
    "analyses/least_squares.py": "_OPTIMA",
    "correlation/basis.py": "WORTHWHILE_DOFS WORTHWHILE_MODES",
    "experiment/modal.py": "_MANY",
    "problem/differences.py": "STEP",
    "correlation/modal/problem.py": "DAMPING_MAX",
    "correlation/modal/whole_solution.py": "_SAME",
    "structure/reduction/certificate.py": "_CLUSTER _LOST",
    "structure/eigenproblem/compression.py": "_BESIDE _COUPLED _NEAREST _STRONG _START _ROOTS _ABOVE _SAME _REACH "
    "_NEGLIGIBLE _PARALLEL",
    "structure/eigenproblem/damped_problem.py": "_ALIKE",
    "structure/reduction/effect_basis.py": "_EFFECTS _POINTS _STRONG _ERROR _NEARER _REFINED _ROWS",
    "structure/reduction/local_derivatives.py": "TOGETHER _ROUNDS _SURE _FORCE _NEGLIGIBLE _COLUMNS",
    "structure/reduction/frf_target.py": "TOLERANCE _BEYOND _SHAPE _LINES",
    "structure/reduction/basis.py": "_ROOM",
    "structure/reduction/growth.py": "SAFETY POD _SHARES _STATIC _COLUMNS VERIFIED _LOCAL _STRAINED",
    "structure/reduction/mode_target.py": "_NEAR REFINED _DIRECTIONS _KEPT",
    "structure/mounted.py": "GROWN_SAG",
    "structure/null_space.py": "_NAMED",
    "structure/relaxation.py": "BRANCHES _BEYOND _LINES",
    "structure/rubber.py": "_MOST_LOSS",
    "structure/eigenproblem/solve_dense.py": "ACCURACY",
    "structure/reduction/training.py": "_FRESH _FIRST _ROUNDS",
}

EFFORT = {  # of iterations and searches that end by themselves, and of quick runs, which say that they are quick
    "structure/effects/compositions.py": "MODES RIGID _DIGITS",
    "structure/effects/rigid_joints.py": "_HELD _SYMMETRIC _ANGLE _TRIED _MOST",
    "structure/effects/terms.py": "_BENDING",
    "hypotheses/linear_start.py": "EQUATION_ERROR LEVEL ROUNDS",
    "hypotheses/modal_start.py": "ENOUGH EQUATION_ERROR EXPLAINED ROUNDS SENSORS",
    "hypotheses/design/imagined.py": "_TRIES",
    "analyses/provenance/places.py": "QUICK_SAMPLES QUICK_POPULATION QUICK_GENERATIONS QUICK_STARTS "
    "QUICK_TRAJECTORIES QUICK_BASE QUICK_SAMPLED",
    "analyses/screening.py": "TRAJECTORIES BASE",
    "analyses/hypotheses_of_study.py": "WIDENED",
    "analyses/least_squares.py": "_WIDENED",
    "analyses/extend.py": "STARTS",
    "correlation/modal/axes.py": "_GROUPS",
    "correlation/modal/order.py": "_STEP",
    "inference/between.py": "LEAST_TESTS _GRID _LEAST _SETTLED _TURNS",
    "inference/cases.py": "FAILED",
    "inference/even_weights.py": "LIMIT MANY",
    "inference/gauss_newton.py": "_HERE _HOPELESS _NEAR _POOR _SAME",
    "inference/integers.py": "_ROUNDS",
    "measurement/frf_repeats.py": "_RANGE _NAMED",
    "measurement/partners.py": "_NEIGHBOURS",
    "measurement/files/csv_frf.py": "LARGE",
    "missing/accuracy.py": "GRID",
    "missing/accuracy_by_kind.py": "GRIDS",
    "missing/competing.py": "_TESTS",
    "missing/discrepancy.py": "_LEAST _POINTS",
    "inference/profile_likelihood.py": "_AIM _CLOSE _CORRECTIONS _MOST",
    "inference/sampled_posterior.py": "WALKERS",
    "missing/linearised_fit.py": "_TURNS",
    "missing/profile.py": "_TRIES",
    "hypotheses/proposals/proposal_search.py": "_DAMPED _FREQS",
    "missing/effect_facts.py": "_ASKED _CLOSE _INWARD _LEAST",
    "modal_analysis/ambient.py": "DECIMATED_MOST",
    "modal_analysis/scatter.py": "STEPS PAIR_START",
    "measurement/thinning.py": "DEGREE NEIGHBOURS QUIET SMOOTHED _POWER",
    "modal_analysis/setups.py": "ROUNDS LEAST_STD",
    "modal_analysis/model.py": "ROUNDS EVALUATIONS SMALLEST_STEP BEYOND BEYOND_DAMPING BEYOND_LINES FARTHEST",
    "problem/prior.py": "_TAIL _NARROWEST",
    "problem/sampling.py": "_FEWEST _TRIES _NARROW",
    "structure/eigenproblem/compression.py": "_STEPS",
    "structure/reduction/refinement.py": "STEPS",
}

SPEED = {  # memory, time, processes; results are the same
    "missing/screened.py": "_ENTRIES",
    "structure/reduction/cache.py": "LIMIT _ABANDONED",
    "hypotheses/hypotheses.py": "_REMEMBERED",
    "analyses/provenance/places.py": "_WORTHWHILE PATIENCE",
    "analyses/sensitivity.py": "_BATCH",
    "analyses/provenance/stored.py": "CHEAP",
    "execution/cluster.py": "WORTHWHILE _TASK _AHEAD _FIRST _LOOK _CONNECT _PATIENCE",
    "execution/cluster_tasks.py": "LONG",
    "execution/cluster_worker.py": "_KEPT",
    "execution/interrupt.py": "CODE PATIENCE LOOK SEEN TURN SLOW",
    "missing/nearest_integers.py": "_ALL_AT_ONCE",
    "missing/suspect.py": "_AT_ONCE",
    "correlation/modal/sensors.py": "_NEAR _BLOCK",
    "errors/own_code.py": "_HEAD_LINES",
    "problem/problem.py": "REMEMBERED AHEAD",
    "analyses/provenance/recorded.py": "WORTH_SHARING SHARED_AFTER",
    "execution/ahead.py": "_ROUNDS",
    "analyses/robustness.py": "QUANTILES _ROUNDS",
    "analyses/refine.py": "CANDIDATES",
    "sensitivity/infill.py": "NEIGHBOURS SHARE",
    "results/results.py": "_ABANDONED",
    "problem/sampling.py": "_BATCH_MAX",
    "structure/eigenproblem/deflation.py": "_BLOCK _STEPS_MIN _STEPS_MAX",
    "structure/frf.py": "_ORDER _DENSE _BLOCK _LOW_RANK",
    "structure/modal_function.py": "REMEMBERED",
    "structure/model.py": "_REMEMBERED _BYTES",
    "structure/places.py": "_ASIDE _FEW",
    "structure/effects/attach.py": "ENDS",
    "structure/eigenproblem/compression.py": "_WORTHWHILE",
    "structure/effects/part_compositions.py": "_FEW",
    "structure/elongations.py": "MOST_MOTIONS _SMALL",
    "structure/eigenproblem/derivatives.py": "_ENTRIES _FEW",
    "structure/eigenproblem/mode_systems.py": "_AT_ONCE",
    "problem/shared_points.py": "_MODELS",
    "structure/eigenproblem/known_modes.py": "_STEPS _FACTOR _BORDERED _COLUMN",
    "structure/eigenproblem/solve.py": "DENSE_LIMIT",
    "structure/eigenproblem/symmetric_factor.py": "DISSECTED _KEPT",
    "structure/eigenproblem/solve_dense.py": "_FEW _LARGE",
    "study/study_file.py": "_KEPT",
    "study/settings.py": "_GRACE",
    "analyses/runs_ahead.py": "_AGREE _EFFECT _EXPLAIN _FIT _STEPS",
    "execution/memory.py": "_PAUSE",
    "execution/team.py": "_MOST _WORTH _TO_START",
    "execution/shared_store.py": "_LARGE _SPARE",
    "execution/temporary.py": "_WITHOUT_LOCK",
    "execution/worker.py": "LEAVING _KEPT _FOR_EVER",
}

WORDS = {  # lengths of lists and lines, and the levels that sentences and tables state
    "problem/sampling.py": "DECADES",
    "missing/reservations.py": "_LISTED",
    "missing/test_order.py": "_BAND _HAMMER _LEAST_REPEATS _LINES _NARROW",
    "analyses/answers.py": "NAMED",
    "analyses/failures.py": "SHOWN",
    "analyses/propose.py": "RANKED",
    "hypotheses/proposals/code.py": "_WIDE",
    "analyses/provenance/stored.py": "SHOWN",
    "inference/rules.py": "WIDE",
    "inference/sampled_posterior.py": "_TAILS",
    "results/answer.py": "LABEL",
    "results/in_short.py": "MOST",
    "results/running.py": "_LENGTH",
    "correlation/modal/axes.py": "_LISTED",
    "correlation/response/problem.py": "_LISTED",
    "errors/place.py": "WIDEST _LEAST TAB",
    "inference/agreement.py": "_NAMED",
    "inference/pareto.py": "BENT",
    "inference/constraints.py": "_LEVEL",
    "measurement/partners.py": "_NAMED _ROUNDED",
    "measurement/sensors.py": "NAMED_MOST",
    "missing/competing.py": "EIGHT_OF_TEN",
    "missing/pattern.py": "MOST",
    "missing/plausible.py": "_NAMED",
    "missing/recommendation.py": "MOST MANY KEPT _HARDLY_SHOWN",
    "missing/tables.py": "CORRELATED",
    "missing/verdict.py": "_REPEATS",
    "missing/words_by_verdict.py": "MOST _DRAWN",
    "missing/goodness.py": "_LEAST",
    "execution/outcome.py": "_TRACE",
    "api/progress.py": "SPARSE OFTEN _BAR _STEADY",
    "api/entries/compared.py": "WORST _FUNCTIONS _INPUTS",
    "api/fe_comparison.py": "DRAWN",
    "correlation/modal/pair_faults.py": "_WHOLE",
    "api/fe_agreement.py": "CLOSE FREQ_AGREES MAC_AGREES _NODES",
    "api/fe_import.py": "MODES _ALIKE _BEYOND _LOOSE _LOOSE_SHARE _MOST _NOTHING",
    "api/entries/entry.py": "MOST WARNINGS WIDTH NARROWEST",
    "api/entries/explained.py": "EFFECTS",
    "study/loading.py": "_LISTED",
}

FORMATS = {  # units, codes of files, and what a file may hold
    "analyses/versions.py": "MOST",
    "correlation/frf/gross_errors.py": "FACTORS",
    "correlation/units.py": "VALUE_FACTORS",
    "study/limits.py": "UNIT_FACTOR",
    "measurement/corrections.py": "_LEAST_GAIN",
    "measurement/files/csv_format.py": "FREQ_LIMIT VALUE_LIMIT FINEST",
    "measurement/files/csv_record.py": "_COMMENTS",
    "measurement/frf_lines.py": "HALF_POWER",
    "measurement/frf_units.py": "GRAVITY LENGTHS FORCES",
    "measurement/places.py": "MILLIMETRES",
    "measurement/files/read_records.py": "_FRF",
    "measurement/record.py": "SAMPLES_FEWEST HIT_SAMPLES_FEWEST",
    "measurement/files/uff.py": "_DAMAGED",
    "measurement/files/uff_labels.py": "_UNSTATED _GENERAL _FORCES _PER_SECOND",
    "measurement/files/uff_nodes.py": "NODES _PER_METRE _CARTESIAN _CYLINDRICAL _SPHERICAL",
    "measurement/files/uff_2414.py": "_AT_NODES _MOTIONS _COMPONENTS",
    "measurement/files/uff_blocks.py": "USED_KINDS MODAL _VALUE_BYTES _ID_LINES",
    "measurement/files/uff_frf.py": "_FRF _COHERENCE _COMPLEX _FREQUENCY",
    "measurement/files/uff_frf_write.py": "_NUMERATOR _FORCE _FREQUENCY _FRF",
    "measurement/files/uff_record.py": "TIME_RESPONSE _TIME _COMPLEX",
    "measurement/files/uff_sets.py": "SI_UNITS _LARGEST_NODE",
    "problem/parameter.py": "MOST FINEST_PRIOR SI_FACTORS _INCH _POUND _FORCE _MOST_EXPONENT",
    "study/measurement_settings.py": "LONGEST_NAME",
    "structure/amplitude.py": "_LEFT",
    "structure/dof_table.py": "_EXACT _PACKED",
    "imports/frd.py": "_COMPONENTS _FIRST _WIDTH",
    "imports/elements.py": "LINE LINE_3 LINE_3_LAST _BRICK _KEYS _TETRA _WEDGE",
    "imports/fil.py": "_NODE _DIRECTIONS _MODE _DISPLACEMENT _MOTIONS",
    "imports/keywords.py": "_DEEPEST",
    "imports/matrices.py": "_PENALTY",
    "imports/meshes.py": "_AROUND_SOLID _BEAMS _ELEMENTS _GMSH _GROUPS _OF_ELEMENT",
    "imports/nastran.py": "_COMPLEX _SQUARE _SYMMETRIC",
    "imports/op2.py": "_EIGENVECTORS _GRID _REAL _REAL_MODES _SYSTEMS _WORDS",
    "imports/op4.py": "_HEADS _TYPES",
    "imports/systems.py": "_KINDS",
    "structure/unit_system.py": "_TOKENS",
    "structure/effects/attach.py": "GRAVITY",
}

ALLOWED = (ROUNDING, ACCURACY, EFFORT, SPEED, WORDS, FORMATS)


def is_number(node: ast.AST) -> bool:
    """Whether a value is a number, an expression or a call with one, or a collection of some."""
    match node:
        case ast.Constant(value=value):
            return isinstance(value, int | float) and not isinstance(value, bool)
        case ast.UnaryOp(operand=one):
            return is_number(one)
        case ast.BinOp(left=left, right=right):
            return is_number(left) or is_number(right)
        case ast.Tuple(elts=some) | ast.List(elts=some) | ast.Set(elts=some) | ast.Dict(values=some):
            return any(is_number(one) for one in some)
        case ast.Call(func=ast.Name(id="tuple" | "frozenset" | "range" | "float" | "int"), args=some):
            return any(is_number(one) for one in some)
    return False


def constants(text: str) -> Iterator[str]:
    """Names of the upper-case numbers at the top of a module."""
    for node in ast.parse(text).body:
        given = (
            node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
        )
        if not given or node.value is None or not is_number(node.value):
            continue
        for target in given:
            names = target.elts if isinstance(target, ast.Tuple) else [target]
            yield from (one.id for one in names if isinstance(one, ast.Name) and one.id.isupper())


def found() -> set[tuple[str, str]]:
    skipped = {ROOT / folder for folder in (*FOLDERS, "template")}
    files = [file for file in ROOT.rglob("*.py") if not skipped & set(file.parents)]
    return {(file.relative_to(ROOT).as_posix(), name) for file in files for name in constants(file.read_text("utf-8"))}


def test_numbers_of_every_form_are_found():
    text = (
        "A = 1\nB: float = -2.5\nC, D = 1, 0.2\nE = (1.0, 2.0)\nF = {'a': 2.0}\nG = 10 * np.log10(2)\n"
        "H = tuple(range(3))\nI = True\nJ = 'x'\nk = 3\nL = K\ndef f():\n    M = 1\n"
    )
    assert list(constants(text)) == list("ABCDEFGH")


def test_a_number_at_the_top_of_a_module_decides_no_verdict():
    allowed = [(file, name) for reason in ALLOWED for file, names in reason.items() for name in names.split()]
    assert len(allowed) == len(set(allowed))
    new = found() - set(allowed)
    assert not new, f"put it into the rules of its subject, or list it here by its reason: {sorted(new)}"
    gone = set(allowed) - found()
    assert not gone, f"it is no constant any more: {sorted(gone)}"
