"""What the real structure did: measured modes with their repeat scatter, read from UFF/UNV or CSV."""
