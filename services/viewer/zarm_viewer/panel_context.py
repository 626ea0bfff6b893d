"""The shared part of one robot's panels: its clients, its state, and its error messages."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import viser
from viser import ClientHandle

from zarm.robot import Robot
from zarm_contract.errors import Unavailable, ZarmError
from zarm_contract.robot import RobotDescription
from zarm_trajectory.arrays import Array
from zarm_viewer.body import Body, body_of
from zarm_viewer.kinematics import Chain

log = logging.getLogger(__name__)

EVENTS = 40
"""Number of recent events shown."""


@dataclass
class PanelContext:
    """One robot on the page; `joints` (J,) are the last measured (rad).

    `client` reaches it on the bus; a record has none.
    """

    server: viser.ViserServer
    name: str
    description: RobotDescription
    client: Robot | None
    moves: bool
    """Whether this page may move robots; that of a viewer role may not."""
    aside: float = 0.0
    """Where its base is in the view (m, along y)."""
    chain: Chain = field(init=False)
    body: Body = field(init=False)
    group: str | None = field(init=False)
    """The group whose tip is aimed with and jogged; None if the robot is one arm."""
    joints: Array = field(init=False)
    tools: tuple[str, ...] = ()
    """The tools that are mounted."""
    measured: bool = False
    """Whether `joints` were measured; otherwise they are the home position."""
    events: deque[str] = field(default_factory=lambda: deque(maxlen=EVENTS))

    def __post_init__(self) -> None:
        self.body = body_of(self.description)
        self.choose(next(iter(self.groups), None))
        self.joints = np.array(self.description.descriptor.home)

    @property
    def groups(self) -> tuple[str, ...]:
        """The groups with a tip."""
        groups = self.description.descriptor.groups
        return tuple(name for name, group in groups.items() if group.tip_link is not None)

    def choose(self, group: str | None) -> None:
        """Aim with the tip of this group from now on."""
        self.group, self.chain = group, Chain(self.description.with_tools(self.tools), group)

    def mount(self, tools: tuple[str, ...]) -> None:
        """Aim with the tips of these tools from now on."""
        if tools != self.tools:
            self.tools = tools
            self.choose(self.group)

    @property
    def moving(self) -> list[int]:
        """The indices of the joints that move with the group."""
        joints = self.description.descriptor.joints
        if self.group is None:
            return [*range(len(joints))]
        return [joints.index(joint) for joint in self.description.group_joints(self.group)]

    @property
    def root(self) -> str:
        """Its node in the scene."""
        return f"/{self.name}"

    @property
    def robot(self) -> Robot:
        """The robot on the bus. Raises Unavailable for a record."""
        if self.client is None:
            raise Unavailable("this page plays a record; `zarm view` shows a live robot")
        return self.client

    def note(self, event: str) -> None:
        """Add an event to the log, which all pages show."""
        self.events.appendleft(f"`{time.strftime('%H:%M:%S')}` {event}")

    def attempt(self, what: str, work: Callable[[], object], client: ClientHandle | None = None) -> bool:
        """Do `work`; returns whether it succeeded. Its ZarmError is shown on the page of `client`, or on all pages."""
        try:
            work()
        except ZarmError as error:
            self.notify(f"{what}: {error.problem.code}", str(error), client, "red")
            return False
        except Exception as error:
            log.exception("failed action=%s", what.replace(" ", "_"))
            self.notify(f"{what} failed", f"{type(error).__name__}; the log of the viewer has the trace", client, "red")
            return False
        return True

    def notify(self, title: str, body: str, client: ClientHandle | None = None, colour: str = "blue") -> None:
        """Show a note on the page of `client`, or on all pages, and in the event log."""
        self.note(f"**{title}** {body}")
        for page in [client] if client is not None else self.server.get_clients().values():
            page.add_notification(title, body, color=colour, auto_close_seconds=10.0)  # type: ignore[call-overload]
