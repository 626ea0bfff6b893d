"""Joints by name, in requests and from drivers.

`joint1` is accepted for `joint_1`: Doosan's drivers have used both, and so have their links.
"""

from __future__ import annotations

import math
import time
from array import array
from collections.abc import Collection, Iterable, Sequence

from sensor_msgs.msg import JointState as RosJointState

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import JointState
from zarm_ros_bridge.convert.fields import finite
from zarm_ros_bridge.convert.times import ros_time

Positions = tuple[float, ...]
"""One per joint, in the descriptor's order; rad."""


def ros_joint_state(state: JointState) -> RosJointState:
    """Measured or previewed joints."""
    message = ros_positions(state.joint_names, state.position, state.velocity)
    message.effort = array("d", state.effort or ())
    message.header.stamp = ros_time(state.stamp)
    return message


def ros_positions(joints: Sequence[str], position: Iterable[float], velocity: Iterable[float] = ()) -> RosJointState:
    """Joints without a time."""
    return RosJointState(name=list(joints), position=array("d", position), velocity=array("d", velocity))


def positions_of(message: RosJointState, joints: Sequence[str], field: str) -> Positions:
    """The positions in a request's `field`, in the order of `joints`.

    By name, ignoring other joints in the message (such as a gripper's); without names, by index. Raises InvalidRequest
    for anything else, and for values that are not finite.
    """
    values = list(message.position)
    if not message.name and len(values) != len(joints):
        raise InvalidRequest(
            f"{len(values)} positions without names for the {len(joints)} joints {', '.join(joints)}; give one for each",
            field=f"{field}.position",
        )
    if message.name and len(values) != len(message.name):
        raise InvalidRequest(
            f"{len(values)} positions for {len(message.name)} names; give one for each", field=f"{field}.position"
        )
    places = places_of(message.name or joints, joints, f"{field}.name")
    return tuple(finite(values[places[joint]], f"{field}.position.{places[joint]}") for joint in joints)


def is_empty(message: RosJointState) -> bool:
    """Whether a client left these joints out."""
    return not message.name and not len(message.position)


def driver_joint_state(
    message: RosJointState, unnamed: Sequence[str], joints: Sequence[str], optional: Sequence[str] = ()
) -> JointState:
    """A driver's joint states: those of `joints`, and of the `optional` ones that are there, ignoring others; without names, those
    of `unnamed` by index.

    Missing velocities, or ones that are not finite, become 0, since some drivers report none. Efforts are left out unless there is a finite one
    for each joint. A stamp of 0 means now.
    Raises InvalidRequest, which names the field, for what cannot be read.
    """
    names = message.name or unnamed
    places = places_of(names, joints, "name")
    position, velocity = message.position, message.velocity or [0.0] * len(names)
    for field, values in (("position", position), ("velocity", velocity)):
        if len(values) != len(names):
            raise InvalidRequest(f"{len(values)} values for {len(names)} joints", field=field)
    reported = sorted((*joints, *(joint for joint in optional if joint in places)), key=places.__getitem__)
    if not all(math.isfinite(position[places[joint]]) for joint in reported):
        raise InvalidRequest("a position is not finite; the driver must tell where each joint is", field="position")
    stamp = message.header.stamp
    return JointState(
        stamp=stamp.sec + stamp.nanosec * 1e-9 if stamp.sec or stamp.nanosec else time.time(),
        joint_names=tuple(reported),
        position=tuple(position[places[joint]] for joint in reported),
        velocity=tuple(speed if math.isfinite(speed := velocity[places[joint]]) else 0.0 for joint in reported),
        effort=_efforts(message.effort, len(names), [places[joint] for joint in reported]),
    )


def _efforts(efforts: Sequence[float], count: int, places: Sequence[int]) -> tuple[float, ...] | None:
    """The efforts at these places; None unless there are `count`, finite at all of the places."""
    if len(efforts) != count:
        return None
    chosen = tuple(efforts[place] for place in places)
    return chosen if all(map(math.isfinite, chosen)) else None


def places_of(names: Sequence[str], joints: Sequence[str], field: str) -> dict[str, int]:
    """The index of each of `joints` in `names`, and of each other name. Raises InvalidRequest if one is missing or
    appears twice.
    """
    places: dict[str, int] = {}
    for place, name in enumerate(names):
        joint = known_as(name, joints)
        if joint in places:
            raise InvalidRequest(f"the joint {name} appears twice; name each joint once", field=f"{field}.{place}")
        places[joint] = place
    missing = [joint for joint in joints if joint not in places]
    if missing:
        raise InvalidRequest(
            f"{', '.join(missing)} missing among {', '.join(names)}; name each of {', '.join(joints)}", field=field
        )
    return places


def known_as(name: str, among: Collection[str]) -> str:
    """The joint or link that is meant: `link6` is `link_6` if there is no other; an unknown name is returned unchanged."""
    if name in among:
        return name
    return next((one for one in among if one.replace("_", "") == name.replace("_", "")), name)
