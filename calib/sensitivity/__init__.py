"""Which parameters matter: samples of the parameter space and rank correlations."""
