"""Runs a module as a program that ends with its parent: `python -m zarm_cli.end_with_parent MODULE ARGUMENTS`.

Standard input is a pipe. The parent holds the other end and never writes; whatever ends the parent,
SIGKILL included, closes it, and the program then gets the SIGTERM that the parent could not send.
"""

from __future__ import annotations

import os
import runpy
import signal
import sys
import threading


def _terminate_at_end_of_input() -> None:
    while os.read(0, 4096):
        pass
    signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGTERM)


if __name__ == "__main__":
    threading.Thread(target=_terminate_at_end_of_input, daemon=True).start()
    del sys.argv[0]
    runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
