"""Experimental modal analysis: modes from measured FRFs, with the rules by which they count."""
