"""A study: a problem in a folder, read from study.toml."""
