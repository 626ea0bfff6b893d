"""The grippers of a robot descriptor: one driven joint each, and how far its fingers are apart."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field

from zarm_contract.messages import NonNegative, Positive
from zarm_contract.section import Section
from zarm_contract.urdf import Joint, Urdf

_SLACK = 1e-6
"""By how much a position may be outside of its joint's limits (rad, m)."""


class Gripper(Section):
    """A gripper with one driven joint; joints that `<mimic>` it in the URDF move with it.

    `positions` and `widths` belong together, from closed to open; in between both change in proportion.
    """

    joint: str
    """The joint that the driver moves."""
    positions: tuple[float, ...] = Field(min_length=2)
    """Positions of the joint, from closed to open (rad, m for a prismatic joint)."""
    widths: tuple[NonNegative, ...] = Field(min_length=2)
    """Opening between the pads at each of them (m)."""
    pads: tuple[str, ...] = Field(min_length=1)
    """The links that touch what is gripped."""
    speed: Positive = 0.1
    """Greatest speed at which the opening changes (m/s)."""
    force: Positive = 40.0
    """Greatest force of the fingers (N)."""
    tolerance: Positive = 0.001
    """How close the opening must be to the commanded one (m)."""
    stall_timeout: Annotated[float, Field(ge=0.05, le=10)] = 0.3
    """Fingers that stand this long on their way have stalled, as on an object (s)."""
    driver_timeout: Positive = 2.0
    """How long the driver may report nothing before a motion of the gripper is given up (s)."""
    action: Annotated[str, Field(min_length=1)] | None = None
    """ROS action of the gripper's controller, `.../gripper_cmd`. Left out: commands go to `driver/gripper/command` on Zenoh only."""
    action_type: Literal["control_msgs/action/GripperCommand", "control_msgs/action/ParallelGripperCommand"] = (
        "control_msgs/action/GripperCommand"
    )
    """The type of that action; `ros2 action list -t` shows it."""

    @property
    def closed(self) -> float:
        """Opening of the closed gripper (m)."""
        return self.widths[0]

    @property
    def open(self) -> float:
        """Opening of the open gripper (m)."""
        return self.widths[-1]

    @property
    def joint_speed(self) -> float:
        """The speed of the joint (rad/s, m/s) at which the opening changes by 1 m/s, on average."""
        return abs(self.positions[-1] - self.positions[0]) / (self.open - self.closed)

    def position(self, width: float) -> float:
        """The position of the joint (rad, m) at which the opening is `width` m, within the range of the gripper."""
        return _between(self.widths, self.positions, width)

    def width(self, position: float) -> float:
        """The opening (m) at a position of the joint (rad, m), within the range of the gripper."""
        if self.positions[0] < self.positions[-1]:
            return _between(self.positions, self.widths, position)
        return _between(self.positions[::-1], self.widths[::-1], position)

    def joints(self, urdf: Urdf) -> dict[str, tuple[float, float]]:
        """Each joint of the gripper with the multiplier and offset by which it follows `joint`."""
        followers = {
            joint.name: joint.mimic[1:]
            for joint in urdf.joint_of_child.values()
            if joint.mimic is not None and joint.mimic[0] == self.joint
        }
        return {self.joint: (1.0, 0.0), **followers}

    def touch_links(self, urdf: Urdf) -> tuple[str, ...]:
        """The links that may touch what it holds: the pads, those that move with the gripper, and the one that carries them."""
        joints = self.joints(urdf)
        carried = [link for link, joint in urdf.joint_of_child.items() if joint.name in joints]
        palms = [joint.parent for joint in urdf.joint_of_child.values() if joint.name in joints]
        return tuple(dict.fromkeys((*self.pads, *carried, *palms)))

    def faults(self) -> Iterator[tuple[str, str]]:
        """What is wrong with its own values, each as key and message."""
        if len(self.positions) != len(self.widths):
            yield "widths", f"{len(self.widths)} values for {len(self.positions)} positions; give one for each"
        if any(b <= a for a, b in pairwise(self.widths)):
            yield "widths", "they must increase, from closed to open"
        steps = [b - a for a, b in pairwise(self.positions)]
        if not (all(step > 0.0 for step in steps) or all(step < 0.0 for step in steps)):
            yield "positions", "they must all increase or all decrease, from closed to open"

    def faults_in(self, urdf: Urdf, arm: Sequence[str]) -> Iterator[tuple[str, str]]:
        """What is wrong beside the URDF and the joints of the arm, each as key and message."""
        joints = {joint.name: joint for joint in urdf.joint_of_child.values()}
        driven = joints.get(self.joint)
        if driven is None:
            yield "joint", f"the joint {self.joint} is not in the URDF; the joints there are {', '.join(joints)}"
        elif self.joint in arm:
            yield "joint", f"{self.joint} is a joint of the arm; name the one that moves the fingers"
        else:
            yield from self._faults_of(driven)
        for pad in self.pads:
            if pad not in urdf.links:
                yield "pads", f"the link {pad} is not in the URDF; the links there are {', '.join(urdf.links)}"

    def _faults_of(self, driven: Joint) -> Iterator[tuple[str, str]]:
        if driven.type == "fixed":
            yield "joint", f'{self.joint} is fixed; give it type="prismatic" or "revolute" in the URDF'
        elif driven.mimic is not None:
            yield "joint", f"{self.joint} mimics {driven.mimic[0]}; name that one"
        elif driven.lower is not None and driven.upper is not None:
            for value in self.positions:
                if not driven.lower - _SLACK <= value <= driven.upper + _SLACK:
                    limits = f"{driven.lower} to {driven.upper}"
                    yield "positions", f"{value} is outside the limits of {self.joint}: {limits}"


def _between(given: Sequence[float], wanted: Sequence[float], value: float) -> float:
    """The value of `wanted` where the increasing `given` has `value`, linear in between, and at the ends the last ones."""
    if value <= given[0]:
        return wanted[0]
    if value >= given[-1]:
        return wanted[-1]
    after = bisect_right(given, value)
    share = (value - given[after - 1]) / (given[after] - given[after - 1])
    return wanted[after - 1] + share * (wanted[after] - wanted[after - 1])
