"""The Python interface: `calib.Problem`, `calib.Fit`, `calib.Study` and their results."""
