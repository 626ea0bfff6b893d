"""The `zarm` command."""

from __future__ import annotations

import sys

from zarm_cli.interrupts import interrupt_once

INTERRUPTED = 130


def main() -> None:
    """Run the command line and exit with its code."""
    interrupt_once()
    try:
        from zarm_cli.commands import run  # takes a third of a second, in which Ctrl-C ends in order already

        code = run()
    except KeyboardInterrupt:
        code = INTERRUPTED
    sys.exit(code)
