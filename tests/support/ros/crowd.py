"""Many clients on ROS: processes of one participant with several nodes each, which ask the bridge everything at once.

DDS limited to one machine looks for 32 participants there, so 50 clients cannot have one each.
"""

from __future__ import annotations

import json
from typing import NamedTuple

from support.client_processes import ClientProcesses
from support.paths import PROGRAMS


class Answer(NamedTuple):
    """The answer to a client; `message` is empty if all is well."""

    service: str
    success: bool
    message: str


class Crowd(ClientProcesses):
    """`processes` of `nodes` clients each, which see the bridge."""

    def __init__(self, processes: int, nodes: int) -> None:
        super().__init__(PROGRAMS / "crowd_client.py", str(nodes), count=processes)

    def ask(self) -> list[Answer]:
        """Let every client ask everything at once; returns every answer."""
        return [Answer(*json.loads(line)) for line in self.ask_at_once()]
