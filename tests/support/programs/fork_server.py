"""Imports a program and loads its kernels, then forks for each request on a socket: `fork_server.py FD zarm_planner.service`.

Modules that the program imports late may follow its own. A request is a line of JSON; the answer is the pid of a process that is the
program with these arguments, in this environment and folder, in a session of its own, writing to these files. The requester must be a
subreaper: it becomes the parent.
"""

from __future__ import annotations

import gc
import importlib
import json
import os
import socket
import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from zarm_contract.codec import build_all
from zarm_runtime import signals

_ONE_THREAD = (
    "a fork has only the thread that forks; {} is not for this server, for it starts others when it is imported"
)


def serve(requests: socket.socket) -> bool:
    """Fork for each request. Returns True in each fork, which has become the requested process, and False when the
    requests end.
    """
    with requests, requests.makefile("rw") as lines:
        for line in lines:
            ready, tell = os.pipe()
            if (parent := os.fork()) == 0:
                if os.fork():
                    os._exit(0)
                become(**json.loads(line))
                os.write(tell, str(os.getpid()).encode())
                for end in (ready, tell):
                    os.close(end)
                return True
            os.close(tell)
            os.waitpid(parent, 0)  # from now on the requester is the parent of the fork
            lines.write(os.read(ready, 16).decode() + "\n")
            lines.flush()
            os.close(ready)
    return False


def become(
    command: list[str],
    environment: dict[str, str],
    folder: str,
    output: str,
    errors: str,
    scheduling: tuple[int, int],
) -> None:
    """Make this fork the process that `command` would have started. `scheduling`: policy and priority."""
    os.setsid()
    policy, priority = scheduling
    os.sched_setscheduler(0, policy, os.sched_param(priority))
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    for path, standard in ((output, 1), (errors, 2)):
        file = os.open(path, os.O_WRONLY | os.O_APPEND)
        os.dup2(file, standard)
        os.close(file)
    sys.orig_argv = command  # used when a service restarts itself
    sys.argv = command[2 if command[1] == "-m" else 1 :]
    importlib.reload(signals)  # its pipe must not be shared between processes


def main() -> int:
    """Serve; the exit code of the program, in each fork."""
    requests, name, *late = sys.argv[1:]
    program, *_ = [import_module(module) for module in (name, *late)]
    build_all()
    if find_spec(warm_up := f"{program.__package__}.warm_up"):
        import_module(warm_up).main()
    if len(list(Path("/proc/self/task").iterdir())) > 1:
        sys.exit(_ONE_THREAD.format(name))
    gc.freeze()  # keep the imported objects shared
    return int(program.main()) if serve(socket.socket(fileno=int(requests))) else 0


if __name__ == "__main__":
    sys.exit(main())
