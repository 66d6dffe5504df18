"""Updating: what is made small, the search that does it, and the cases it is run in."""
