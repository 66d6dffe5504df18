"""A calibration from Python, cell by cell, as in a notebook.

It runs in any folder that holds the measured files of the hidden bogie (``measured/*.uff`` and ``sensors.csv`` of
``studies/hidden_bogie``, synthetic) and the study ``studies/bogie``.
"""

# %% Model and measurement. A model turns named parameters into modes; a test holds measured modes under one condition.
import calib
from models.railway import bogie_effects, bogie_on_rig

modes = calib.read_modes("measured/*.uff", sensors="sensors.csv", synthetic=True)
test = calib.ModalTest(modes, held_out=["4BT", "9BT", "101y", "110y"], mode_count=12, freq_window=(1.0, 50.0))
problem = calib.Problem(bogie_on_rig(), test)

# %% Compare without fitting: where does the model fail? Held-out modes and sensors never enter a fit; they verify it.
print(problem.compare())

# %% Fit all free parameters (or some: calibrate(["K_primary", "K_block"])). The result has each standard deviation
# and whether the data identify the parameter.
fit = problem.calibrate()
print(fit)
print(fit.errors)  # on fitted data, with each mode left out in turn, and on held-out data

# %% Why does it still not fit? The missing effect, its evidence, where to look, and the recommended next measurement.
why = fit.explain(bogie_effects())
print(why)

# %% Add the named effect, fit again, and compare the errors.
better = problem.with_effects(why.named).calibrate()
print(better.errors)
better.figure("frequency_errors").figure.savefig("frequency_errors.png")
better.report("report.html")

# %% The same from a study folder, with ledger, resume and results; quick=True runs small searches.
study = calib.Study.load("studies/bogie", quick=True).run()
print(study)
