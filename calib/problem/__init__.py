"""Parameters, effects, candidates, and a problem: residual and Jacobian."""
