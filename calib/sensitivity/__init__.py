"""Global sensitivity analysis: rank correlations, variance shares, elementary effects, and parameter selection."""
