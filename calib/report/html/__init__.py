"""The page that tells a whole study: tables in, one HTML file out."""
