"""What fits, how it is found, and how far the data determine it: least squares, searches, identifiability."""
