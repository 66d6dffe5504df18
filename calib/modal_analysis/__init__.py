"""Experimental modal analysis: modes from measured FRFs or ambient records, with the rules by which they count."""
