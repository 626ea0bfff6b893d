"""The `zarm` command."""

from __future__ import annotations

from zarm_runtime import signals

INTERRUPTED = 130


def main() -> None:
    """Run the command line and exit with its code."""
    signals.expect()  # before the imports, which take a while
    import os

    from zarm_cli.commands import run
    from zarm_cli.interrupts import check, pending

    try:
        check()
        code = run()
    except KeyboardInterrupt:
        code = INTERRUPTED
    os._exit(INTERRUPTED if pending() else code)
