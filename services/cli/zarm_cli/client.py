"""A client of one robot on the bus: which robot, and requests made from what a person typed."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated, TypeVar

import typer

from zarm_cli.interrupts import attend
from zarm_contract.codec import decode
from zarm_contract.errors import ExecutionRefused, InvalidRequest, Unavailable
from zarm_contract.keys import ALL_ALIVE, Keys
from zarm_contract.messages import FkPoses, FkRequest, Joints, JointState, Message, Nothing, Pose
from zarm_runtime.bus import Bus
from zarm_runtime.session import spoken

Connect = Annotated[str, typer.Option(envvar="ZARM_CONNECT", help="The router's endpoint.")]
Name = Annotated[
    str | None, typer.Option(envvar="ZARM_NAME", help="The robot's name on the bus; left out: the only one there.")
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON, as it goes over the bus.")]

_CONNECT_SECONDS = 2.0
_ANSWER_SECONDS = 5.0

M = TypeVar("M", bound=Message)
Reply = TypeVar("Reply", bound=Message)


@dataclass(frozen=True)
class Client:
    """A session and the keys of one robot."""

    bus: Bus
    keys: Keys
    endpoint: str

    def ask(
        self, key: str, reply: type[Reply], request: Message | None = None, *, timeout: float = _ANSWER_SECONDS
    ) -> Reply:
        """A request that is answered within `timeout` s. Raises what the service answers, Unavailable, or KeyboardInterrupt."""
        return attend(lambda: self.bus.call(key, request or Nothing(), reply, timeout=timeout))

    def read(self, key: str, model: type[Reply]) -> Reply:
        """The present value of a key, which nothing is asked to change. Raises Unavailable, or KeyboardInterrupt."""
        return attend(lambda: self.bus.read(key, model, timeout=_ANSWER_SECONDS))

    def measured(self) -> JointState:
        """The robot's joints as measured now. Raises ExecutionRefused (no_joint_state)."""
        newest = self.bus.latest(self.keys.joint_states, JointState)
        state = attend(lambda: newest.wait(_CONNECT_SECONDS))
        if state is None:
            raise ExecutionRefused(
                f"no joint state of {self.keys.robot} came within {_CONNECT_SECONDS:g} s; `zarm status` shows whether "
                "its executor runs and with which strategy",
                code="no_joint_state",
            )
        return state

    def tip(self, joints: Joints) -> Pose:
        """The tip's pose (in the base frame) at these joints (rad), computed by the planner."""
        return self.ask(self.keys.fk, FkPoses, FkRequest(joints=(joints,))).poses[0]


@contextmanager
def connected(connect: str, name: str | None) -> Iterator[Client]:
    """A client of the robot `name`, or of the only robot on the bus.

    Raises Unavailable without a router or a robot, InvalidRequest where there are several or the name is none.
    """
    with Bus(connect, timeout=_CONNECT_SECONDS) as bus:
        place = spoken(connect)
        yield Client(bus, keys_of(name if name is not None else _only_robot(bus, place)), place)


def keys_of(name: str) -> Keys:
    """The keys of a robot. Raises InvalidRequest for a name that cannot be one."""
    try:
        return Keys(name)
    except ValueError as error:
        raise InvalidRequest(str(error), field="--name") from error


def _only_robot(bus: Bus, endpoint: str) -> str:
    robots = sorted({robot for robot, _, _ in bus.alive(ALL_ALIVE)})
    if not robots:
        raise Unavailable(f"no robot is alive on the bus at {endpoint}; start one with `zarm up`")
    if len(robots) > 1:
        raise InvalidRequest(f"several robots are alive at {endpoint}: {', '.join(robots)}; choose one", field="--name")
    return robots[0]


def message(model: type[M], **fields: object) -> M:
    """A message from what a person typed; None is left out. Raises InvalidRequest that names the field."""
    return decode(model, json.dumps({name: value for name, value in fields.items() if value is not None}).encode())


def floats(text: str, option: str, *counts: int) -> list[float]:
    """The numbers of `0.4,-0.2,0.5`; as many as one of `counts`, or any number. Usage error else."""
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        raise typer.BadParameter(f"{text!r} must be numbers with commas between them", param_hint=option) from None
    if counts and len(values) not in counts:
        expected = " or ".join(str(count) for count in counts)
        raise typer.BadParameter(f"{text!r} holds {len(values)} numbers where {expected} are needed", param_hint=option)
    return values


def joints(text: str | None, option: str) -> list[float] | None:
    """The joint vector (rad) given for an option that may be left out."""
    return None if text is None else floats(text, option)
