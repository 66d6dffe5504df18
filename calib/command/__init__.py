"""What the command prints: an answer in four lines, then short tables; with ``--verbose`` all of it."""
