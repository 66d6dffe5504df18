"""A calibration from Python, cell by cell: what a notebook does with `calib`.

It runs in any folder that holds the measured files of the hidden bogie (``measured/*.uff`` and ``sensors.csv`` of
``studies/hidden_bogie``, synthetic) and the study ``studies/bogie``.
"""

# %% Model and measurement. A model turns named parameters into modes; a test is what the real thing did.
import calib
from models.railway import bogie_effects, bogie_on_rig

modes = calib.read_modes("measured/*.uff", sensors="sensors.csv", synthetic=True)
test = calib.ModalTest(modes, held_out=["4BT", "9BT", "101y", "110y"], mode_count=12, freq_window=(1.0, 50.0))
problem = calib.Problem(bogie_on_rig(), test)

# %% Where does the model fail? Nothing is fitted; the modes and sensors held out are never fitted and check what is.
print(problem.compare())

# %% Fit all free parameters (or some: calibrate(["K_primary", "K_block"])). Each comes with its standard deviation and
# whether the data determine it.
fit = problem.calibrate()
print(fit)
print(fit.errors)  # on data used, each mode left out in turn, and held out

# %% Why does it still not fit? What is missing, how sure that is, where to look, and what to measure next.
why = fit.explain(bogie_effects())
print(why)

# %% Add what was named, fit again, and look.
better = problem.with_effects(why.named).calibrate()
print(better.errors)
better.figure("frequency_errors").figure.savefig("frequency_errors.png")
better.report("report.html")

# %% The same from a folder, with ledger, resume and results; whole without quick=True.
study = calib.Study.load("studies/bogie", quick=True).run()
print(study)
