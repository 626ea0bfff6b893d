"""The bridge with each generation of curobo_msgs, and clients with the same."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import sysconfig
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from support.harness import ServiceProcess
from support.paths import PROGRAMS, ROOT
from support.ros.stack import KEYS
from zarm_contract.messages import Health
from zarm_runtime.bus import Bus

BUILD = ROOT / "services" / "ros_bridge" / "build_messages.py"
OTHERS = ROOT / "tests" / "ros" / "data"
"""ROS packages that PyPI lacks, with only what is needed."""


def built(generation: str, folder: Path) -> dict[str, str]:
    """Build the messages into `folder`, with the other packages they need; returns an environment that finds these
    first.
    """
    subprocess.run(
        [sys.executable, BUILD, generation, "--into", folder, "--with", *sorted(OTHERS.iterdir())],
        check=True,
        timeout=300,
        stdout=subprocess.DEVNULL,
    )
    site = Path(sysconfig.get_path("purelib")).relative_to(sys.prefix)
    libraries = os.pathsep.join([str(folder / "lib"), os.environ.get("LD_LIBRARY_PATH", "")])
    return {"PYTHONPATH": str(folder / site), "LD_LIBRARY_PATH": libraries}


@dataclass
class Typed:
    """A bridge and a client with the classes of one generation."""

    generation: str
    bridge: ServiceProcess
    health: Health
    _client: subprocess.Popen[str]

    def call(self, name: str, kind: str, /, **request: Any) -> Any:
        """The response of a service, whose type is of curobo_msgs unless it has a package."""
        kind = kind if "/" in kind else f"curobo_msgs/srv/{kind}"
        return self._ask({"service": name, "type": kind, "request": request})

    def send(self, name: str, kind: str, /, **goal: Any) -> Any:
        """The status, result and feedback of a goal."""
        return self._ask({"action": name, "type": f"curobo_msgs/action/{kind}", "goal": goal})

    def parameter(self, name: str) -> Any:
        """The value of a parameter."""
        return self._ask({"parameter": name})

    def _ask(self, question: dict[str, Any]) -> Any:
        assert self._client.stdin is not None
        assert self._client.stdout is not None
        self._client.stdin.write(json.dumps(question) + "\n")
        self._client.stdin.flush()
        answer = self._client.stdout.readline()
        assert answer, f"the client ended on {question}; the log of the bridge:\n{self.bridge.output()}"
        return json.loads(answer)


@contextmanager
def typed(generation: str, endpoint: str, bus: Bus, folder: Path) -> Iterator[Typed]:
    """Bridge and client; the planner and the executor of `arm` run."""
    environment = built(generation, folder / "messages")
    with ExitStack() as started:
        bridge = started.enter_context(
            ServiceProcess("ros_bridge", endpoint, folder, name=KEYS.robot, environment=environment)
        )
        client = started.enter_context(
            subprocess.Popen(
                [sys.executable, str(PROGRAMS / "typed_client.py")],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
                env=os.environ | environment,
            )
        )
        yield Typed(generation, bridge, bridge.wait_ready(bus, KEYS), client)
