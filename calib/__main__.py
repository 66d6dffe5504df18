"""``python -m calib`` and the entry point of the command; interrupts are handled before anything heavy is imported."""

from __future__ import annotations

import sys

from calib.execution import interrupt


def main() -> None:
    """Run the command."""
    try:
        interrupt.once()
        from calib.command.cli import main as command

        command()
    except KeyboardInterrupt:  # before the command handles it
        interrupt.command_over()
        sys.stderr.write(f"calib: {interrupt.WORDS}\n")
        sys.exit(interrupt.CODE)


if __name__ == "__main__":
    main()
