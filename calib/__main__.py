"""``python -m calib`` and the entry point of the command; nothing heavy is imported before an interrupt can be told."""

from __future__ import annotations

import sys


def main() -> None:
    """Run the command."""
    try:
        from calib.cli import main as command
    except KeyboardInterrupt:
        sys.stderr.write("calib: interrupted; the same command continues where it was\n")
        sys.exit(130)
    command()


if __name__ == "__main__":
    main()
