"""The report of a whole study: tables in, one HTML file out."""
