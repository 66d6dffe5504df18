"""The structures: each function here returns a `calib.structure.model.StructuralModel`."""
