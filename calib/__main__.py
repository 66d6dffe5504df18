"""``python -m calib`` and the entry point of the command; interrupts are handled before anything heavy is imported."""

from __future__ import annotations

import os
import sys

from calib.execution import interrupt


def main() -> None:
    """Run the command."""
    _open_streams()
    try:
        interrupt.once()
        from calib.command.cli import main as command

        command()
    except KeyboardInterrupt:  # before the command handles it
        interrupt.command_over()
        sys.stderr.write(f"calib: {interrupt.WORDS}\n")
        sys.exit(interrupt.CODE)


def _open_streams() -> None:
    """Standard streams that were closed lead nowhere; else the next file opened would take their place."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode))


if __name__ == "__main__":
    main()
