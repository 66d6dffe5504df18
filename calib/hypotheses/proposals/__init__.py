"""Effects composed of local perturbations."""
