"""Figures and the page of a study, drawn from its tables; nothing is computed anew."""
