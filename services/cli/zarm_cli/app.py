"""The `zarm` command."""

from __future__ import annotations

import sys

from zarm_cli.interrupts import check, expect, pending

INTERRUPTED = 130


def main() -> None:
    """Run the command line and exit with its code."""
    expect()
    from zarm_cli.commands import run  # takes a third of a second, in which Ctrl-C ends in order already

    try:
        check()
        code = run()
    except KeyboardInterrupt:
        code = INTERRUPTED
    sys.exit(INTERRUPTED if pending() else code)
