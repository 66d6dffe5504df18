"""Models of structures; most functions here return a `calib.structure.model.StructuralModel`."""
