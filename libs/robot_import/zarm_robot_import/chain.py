"""Which joints of a URDF are the arm, and what is fixed to each of its links."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from zarm_contract.errors import InvalidRequest
from zarm_robot_import.description import Description, Joint
from zarm_trajectory.arrays import Array

LARGEST = 20.0
"""A link larger than this, or a joint further than this (m) from its parent link, must be in millimetres."""
MAX_FIXED_POSITION = 100.0
"""Largest position (rad, m) at which a joint without limits may be fixed."""
MOST_JOINTS = 32
"""The most that a descriptor takes."""
_TIPS = ("tool0", "tcp", "ee_link", "tool", "flange", "end_effector")
"""Names of tips, best first."""
_CLOSED = 0.2
"""How near to one of its limits a jaw is closed, as a share of its range."""
_ARM = 4
"""Number of joints after which an arm may end; an earlier branch belongs to a larger robot."""


@dataclass(frozen=True)
class Mounted:
    """A link, and its pose (4, 4) in the link of the chain that carries it; `body` counts the moving joints before it."""

    link: str
    body: int
    pose: Array


@dataclass(frozen=True)
class Group:
    """Joints that move a tip: of an `arm`, without those that it shares with others; these; or all of one arm."""

    name: str
    tip: str
    joints: tuple[str, ...]
    arm: bool = False


class SeveralChains(InvalidRequest):
    """Several chains start at one link; `tips` are their ends where each has one."""

    def __init__(self, message: str, tips: Sequence[str]) -> None:
        super().__init__(message)
        self.tips = tuple(tips)


@dataclass(frozen=True)
class Chain:
    """The arm: its moving joints, and every link in the frame of the link that moves with it.

    `carriers` (dof + 1) are the base link and the child of each moving joint. `parents` (dof,) are the indices of the carriers on
    which the joints are, and `origins` (dof, 4, 4) the joints' frames there. A robot with several arms is a tree of them, and has `groups`. `fixed` are the joints that move in the URDF but stand still here, with their
    positions; `free` are floating or planar joints, which stay at their origins. `mimics` says which of `fixed` are not
    at the position that their <mimic> prescribes, and why.
    """

    base: str
    tip: str
    joints: tuple[Joint, ...]
    carriers: tuple[str, ...]
    parents: tuple[int, ...]
    origins: tuple[Array, ...]
    mounted: tuple[Mounted, ...]
    fixed: tuple[tuple[str, float], ...]
    free: tuple[Joint, ...]
    mimics: tuple[str, ...]
    gripper: tuple[str, ...]
    """The joints behind the tip's rigid part, which are taken as a gripper."""
    chosen: str | None = None
    """What chose the joints."""
    groups: tuple[Group, ...] = ()

    @property
    def reason(self) -> str:
        """Why these joints are the arm."""
        if self.groups:
            return f"They are the moving joints in a row from `{self.base}` on, of each arm; --tip takes one alone."
        if self.chosen:
            return f"{self.chosen} chose them."
        row = f"They are the moving joints in a row from `{self.base}` on"
        if self.gripper:
            return (
                f"{row}; behind `{self.tip}` joints stand side by side, or mimic one another, as those of a gripper do."
            )
        return f"{row}, up to the last one."

    @property
    def tips(self) -> tuple[str, ...]:
        """The tip of each arm."""
        return tuple(group.tip for group in self.groups if group.arm) or (self.tip,)

    @property
    def reach(self) -> float:
        """How far (m) the joints lie from one another, and slide, all together."""
        apart = sum(float(np.linalg.norm(origin[:3, 3])) for origin in self.origins)
        slides = [joint for joint in self.joints if joint.type == "prismatic"]
        return apart + sum((joint.upper or 0.0) - (joint.lower or 0.0) for joint in slides)

    def poses(self, q: Array) -> dict[str, Array]:
        """The poses (n, 4, 4) of every link in the base frame, at joint positions (n, dof)."""
        carried = [np.tile(np.eye(4), (len(q), 1, 1))]
        for joint, parent, origin, values in zip(self.joints, self.parents, self.origins, q.T, strict=True):
            carried.append(carried[parent] @ origin @ joint.motions(values))
        return {mounted.link: carried[mounted.body] @ mounted.pose for mounted in self.mounted}


def choose_chain(
    robot: Description,
    base: str | None = None,
    tip: str | None = None,
    positions: Mapping[str, float] | None = None,
    names: Sequence[str] = (),
) -> Chain:
    """The chain from `base` (default: the root) to `tip` (default: the only sensible one, or one for each of several arms).

    `names` are the arm's joints in order, if they are chosen; others between them stand fixed. `positions` of joints outside
    the chain replace 0, or the value nearest to it within their limits. Raises InvalidRequest: with the choices if there
    are several, and for robots that cannot be planned for.
    """
    asked = tip is not None
    base = _known(robot, base, "--base") if base else robot.root
    chosen = _named(robot, names)
    end = _end(robot, chosen[-1].child) if chosen else None
    try:
        tip = _known(robot, tip, "--tip") if tip else end or _tip(robot, base)
    except SeveralChains as several:
        if (tree := _tree(robot, base, several.tips, dict(positions or {}))) is None:
            raise
        return tree
    path = robot.path(base, tip)
    if path is None:
        remedy = "swap them" if robot.path(tip, base) else "choose --base and --tip on one branch"
        raise InvalidRequest(
            f"{robot.source.path}: no chain of joints leads from the base {base} to the tip {tip}; {remedy}"
        )
    start = next((joint for joint in path if joint.type != "fixed"), None)
    if start is not None and start.type not in ("floating", "planar"):
        start = None
    if base == robot.root and start is not None:
        # A floating base, as simulators define it: the arm stands on the floating link.
        base, path = start.child, path[path.index(start) + 1 :]
    joints = tuple(joint for joint in path if joint.type != "fixed" and (not chosen or joint in chosen))
    if chosen and joints != chosen:
        order = ", ".join(joint.name for joint in path if joint.type != "fixed")
        raise InvalidRequest(
            f"{robot.source.path}: {', '.join(names)} are not joints of one chain from {base} to {tip} in their order, which is {order}",
            field="--joints",
        )
    _check_joints(robot, joints)
    if not joints and start is not None:
        raise robot.source.fault(
            start.element,
            f"joint {start.name} is {start.type}, which an arm's joint cannot be, and no joint after it moves",
        )
    if not joints:
        raise InvalidRequest(f"{robot.source.path}: no joint moves between {base} and {tip}; choose another --tip")
    if len(joints) > MOST_JOINTS:
        raise InvalidRequest(
            f"{robot.source.path}: {len(joints)} joints move between {base} and {tip}, more than {MOST_JOINTS}; choose a --base "
            "further out"
        )
    chain = _assembled(robot, base, tip, joints, dict(positions or {}))
    return replace(chain, chosen="`--joints`" if names else "`--tip`" if asked else None)


def _tree(robot: Description, base: str, tips: Sequence[str], positions: dict[str, float]) -> Chain | None:
    """The tree of the arms that lead to these tips; None if they are too many for a descriptor."""
    paths = [list(robot.path(base, tip) or ()) for tip in tips]
    start = next((joint for joint in paths[0] if joint.type != "fixed"), None) if paths else None
    if base == robot.root and start is not None and start.type in ("floating", "planar"):
        base, paths = start.child, [path[path.index(start) + 1 :] if start in path else path for path in paths]
    moving = [[joint for joint in path if joint.type != "fixed"] for path in paths]
    joints = tuple({joint.name: joint for path in moving for joint in path}.values())
    if len(tips) < 2 or len(joints) > MOST_JOINTS:
        return None
    _check_joints(robot, joints)
    own = [[joint.name for joint in path if sum(joint in other for other in moving) == 1] for path in moving]
    names = _group_names(own)
    groups = [Group(name, tip, tuple(joints), arm=True) for name, tip, joints in zip(names, tips, own, strict=True)]
    if shared := [joint for joint in joints if sum(joint in path for path in moving) > 1]:
        groups.append(Group("torso", shared[-1].child, tuple(joint.name for joint in shared)))
        groups += [
            Group(f"torso+{name}", tip, tuple(joint.name for joint in path))
            for name, tip, path in zip(names, tips, moving, strict=True)
        ]
    chain = _assembled(robot, base, tips[0], joints, positions)
    return replace(chain, groups=tuple(groups))


def _group_names(joints: Sequence[Sequence[str]]) -> list[str]:
    """A name for each arm: the first word that all its joints have and those of the others have not, or its number."""
    words = [[re.findall(r"[a-z]+", name.lower()) for name in own] for own in joints]
    names = []
    for number, own in enumerate(words):
        others = {word for other in words if other is not own for name in other for word in name}
        common = (word for word in own[0] if word not in others and all(word in name for name in own))
        names.append(next(common, f"arm_{number + 1}"))
    return names if "torso" not in names else [f"arm_{number + 1}" for number in range(len(names))]


def _check_joints(robot: Description, joints: Sequence[Joint]) -> None:
    """Raises InvalidRequest for a joint that an arm cannot have."""
    for joint in joints:
        if joint.type in ("floating", "planar"):
            raise robot.source.fault(
                joint.element,
                f"joint {joint.name} is {joint.type}, which an arm's joint cannot be; start after it: --base {joint.child}",
            )
        if joint.mimic:
            raise robot.source.fault(
                joint.element,
                f"joint {joint.name} of the chain mimics {joint.mimic[0]}, so it has no drive of its own, and zarm plans only for joints "
                'that have; give it type="fixed", drop <mimic> if a motor turns it, or end the chain before it: --tip '
                f"{joint.parent}",
            )
        if (away := float(np.linalg.norm(joint.origin[:3, 3]))) > LARGEST:
            raise robot.source.fault(
                joint.element,
                f"the origin of joint {joint.name} is {away:.4g} m from {joint.parent}, so it is in mm; divide every xyz by 1000",
            )


def _named(robot: Description, names: Sequence[str]) -> tuple[Joint, ...]:
    every = {joint.name: joint for joint in robot.joint_of_child.values() if joint.type != "fixed"}
    for name in names:
        if name not in every:
            close = difflib.get_close_matches(name, every, 1)
            hint = f"did you mean {close[0]}?" if close else f"those that move are {', '.join(every)}"
            raise InvalidRequest(f"{robot.source.path}: there is no moving joint {name}; {hint}", field="--joints")
    return tuple(every[name] for name in names)


def _known(robot: Description, link: str, option: str) -> str:
    if link in robot.links:
        return link
    close = difflib.get_close_matches(link, robot.links, 1)
    hint = f"did you mean {close[0]}?" if close else f"the links are {', '.join(robot.links)}"
    raise InvalidRequest(f"{robot.source.path}: there is no link {link}; {hint}", field=option)


def _tip(robot: Description, base: str) -> str:
    """The end of the arm: the first link that carries two moving parts, such as fingers, or the last one."""
    link = base
    count = 0
    while True:
        branches = _moving_below(robot, link)
        if len(branches) == 1 and not (count and _is_gripper(robot, branches)):
            if count >= _ARM and _may_be_jaw(robot, link, branches[0]):
                last, jaw = _end(robot, link), _end(robot, branches[0].child)
                raise InvalidRequest(
                    f"{robot.source.path}: the joint {branches[0].name} may be the arm's last one or a gripper; choose one: --tip {last} "
                    f"(a gripper), --tip {jaw} (of the arm)"
                )
            count += 1
            link = branches[0].child
            continue
        longest = [branch for branch in branches if _length(robot, branch) >= _ARM]
        if len(longest) == 1 and count < _ARM:  # an arm beside wheels, or a head
            count += 1
            link = longest[0].child
            continue
        if (len(longest) > 1 and count < _ARM) or count == 0:
            ends = [end for branch in (longest if len(longest) > 1 else branches) for end in _offered(robot, branch)]
            if not ends:
                raise robot.source.fault(
                    robot.links[link].element, f"no joint behind {link} moves; an arm has revolute or prismatic joints"
                )
            shown = ", ".join(f"--tip {end}" for end in ends[:12])
            tips = ends if len(longest) > 1 and len(ends) == len(longest) else ()
            raise SeveralChains(f"{robot.source.path}: several chains start at {link}; choose one: {shown}", tips)
        if branches and count < _ARM and not _is_gripper(robot, branches):
            ends = [_end(robot, link), *(end for branch in branches for end in _offered(robot, branch))]
            shown = ", ".join(f"--tip {end}" for end in ends[:12])
            raise InvalidRequest(f"{robot.source.path}: several chains go on from {link}; choose one: {shown}")
        return _end(robot, link)


def _end(robot: Description, link: str) -> str:
    """The tip on the rigid part of a link: a frame with a usual name, or the only end, or the link itself."""
    fixed = _rigid(robot, link)
    leaves = [end for end in fixed if not any(j.child in fixed for j in robot.children.get(end, ()))]
    for name in _TIPS:
        named = [one for one in fixed if one == name or one.endswith((f"_{name}", f"-{name}"))]
        if named:
            return named[0]
    return leaves[0] if len(leaves) == 1 else link


def _offered(robot: Description, branch: Joint) -> list[str]:
    """Tips to choose from on a branch: the end of its arm, or otherwise all ends."""
    try:
        return [_tip(robot, branch.child)]
    except InvalidRequest:
        return _ends(robot, branch.child)


def _is_gripper(robot: Description, branches: Sequence[Joint]) -> bool:
    """Whether moving joints on one rigid part are a gripper: one that drives joints which mimic it or mimics itself, and behind
    which none has a drive of its own; or several alike, side by side.
    """
    every = robot.joint_of_child.values()
    driven = {joint.mimic[0] for joint in every if joint.mimic}
    if any(joint.mimic or joint.name in driven for joint in branches):
        return not any(_drives_behind(robot, joint) for joint in branches if joint.mimic or joint.name in driven)
    lengths = {_length(robot, joint) for joint in branches}
    return len(branches) > 1 and len(lengths) == 1 and len({joint.type for joint in branches}) == 1


def _drives_behind(robot: Description, joint: Joint) -> bool:
    return any(
        behind.type != "fixed" and not behind.mimic
        for link in robot.below(joint.child)
        for behind in robot.children.get(link, ())
    )


def _may_be_jaw(robot: Description, link: str, joint: Joint) -> bool:
    """Whether the last joint of a chain may as well be a gripper of one jaw: a slide, a joint that opens to one side only, by less than
    half a turn, or one beside which a frame without geometry marks the tip already.
    """
    if _moving_below(robot, joint.child):
        return False
    frames = [
        one
        for one in _rigid(robot, link)
        if one != link and not (robot.links[one].visual or robot.links[one].collision or robot.children.get(one))
    ]
    return joint.type == "prismatic" or _opens(joint) or bool(frames and len(_rigid(robot, joint.child)) == 1)


def _opens(joint: Joint) -> bool:
    if joint.lower is None or joint.upper is None:
        return False
    width = joint.upper - joint.lower
    return 0.0 < width < math.pi and min(abs(joint.lower), abs(joint.upper)) < _CLOSED * width


def _moving_below(robot: Description, link: str) -> list[Joint]:
    """The moving joints on all links that are rigidly connected with a link."""
    return [joint for one in _rigid(robot, link) for joint in robot.children.get(one, ()) if joint.type != "fixed"]


def _rigid(robot: Description, link: str) -> list[str]:
    """A link and all links connected to it by fixed joints."""
    found, waiting = [], [link]
    while waiting:
        found.append(waiting.pop())
        joints = robot.children.get(found[-1], ())
        waiting += [joint.child for joint in reversed(joints) if joint.type == "fixed"]
    return found


def _length(robot: Description, joint: Joint) -> int:
    """The greatest number of moving joints in a row, from a joint on."""
    length, branches = 0, [joint]
    while branches:
        length += 1
        branches = [one for branch in branches for one in _moving_below(robot, branch.child)]
    return length


def _ends(robot: Description, link: str) -> list[str]:
    """The ends of the moving branches from a link on."""
    ends, waiting = [], [link]
    while waiting:
        one = waiting.pop()
        below = _moving_below(robot, one)
        waiting += [joint.child for joint in reversed(below)]
        ends += [] if below else [one]
    return ends


def _assembled(robot: Description, base: str, tip: str, joints: Sequence[Joint], positions: dict[str, float]) -> Chain:
    moving = {joint.name for joint in joints}
    every = {joint.name: joint for joint in robot.joint_of_child.values()}
    _check_fixed(robot, positions, every, moving)
    stands: dict[str, float] = {}

    def position(joint: Joint, mimics: tuple[str, ...] = ()) -> float:
        if joint.name in mimics:
            raise robot.source.fault(
                joint.element, f"joint {joint.name} mimics itself, by way of {' and '.join(mimics)}; drop one <mimic>"
            )
        if joint.type == "fixed":
            return 0.0
        if joint.name in stands:
            return stands[joint.name]
        if joint.name in positions:
            value = positions[joint.name]
        elif joint.mimic and joint.mimic[0] in every and joint.mimic[0] not in moving:
            value = joint.mimic[1] * position(every[joint.mimic[0]], (*mimics, joint.name)) + joint.mimic[2]
        else:
            low, high = joint.lower, joint.upper
            value = min(max(0.0, low), high) if low is not None and high is not None and low <= high else 0.0
        stands[joint.name] = value
        return value

    pose = {robot.root: np.eye(4)}  # all joints at their fixed positions, those of the chain at 0
    order = [robot.root]
    for link in order:
        for joint in robot.children.get(link, ()):
            still = joint.type == "fixed" or joint.name in moving or joint.type in ("floating", "planar")
            pose[joint.child] = pose[link] @ joint.moved(0.0 if still else position(joint))
            order.append(joint.child)
    carriers = (base, *(joint.child for joint in joints))
    number = {base: 0}
    mounted = []
    for link in _outwards(robot, base, order):
        if link == base:
            body = 0
        else:
            carried = robot.joint_of_child.get(link)
            above = number.get(carried.parent, 0) if carried else 0
            body = carriers.index(link) if link in carriers else above
            if robot.path(base, link) is None:
                body = 0
        number[link] = body
        mounted.append(Mounted(link, body, np.linalg.inv(pose[carriers[body]]) @ pose[link]))
    parents = tuple(number[joint.parent] for joint in joints)
    origins = tuple(
        np.linalg.inv(pose[carriers[parent]]) @ pose[joint.child] for parent, joint in zip(parents, joints, strict=True)
    )
    fixed = tuple((name, value) for name, value in stands.items())
    free = tuple(joint for joint in every.values() if joint.type in ("floating", "planar"))
    last = [joint.child for index, joint in enumerate(joints) if index + 1 not in parents]
    behind = {joint.name for end in last for link in robot.below(end) for joint in robot.children.get(link, ())}
    gripper = tuple(name for name in stands if name in behind)
    return Chain(
        base,
        tip,
        tuple(joints),
        carriers,
        parents,
        origins,
        tuple(mounted),
        fixed,
        free,
        tuple(_unheeded(stands, positions, every, moving)),
        gripper,
    )


def _check_fixed(
    robot: Description, positions: Mapping[str, float], every: Mapping[str, Joint], moving: Collection[str]
) -> None:
    """Raise InvalidRequest unless each of the `positions` is one in which a joint outside the chain can stand."""
    for name, value in positions.items():
        if name not in every or name in moving:
            why = "moves with the arm" if name in moving else "is not in the file"
            raise InvalidRequest(
                f"{robot.source.path}: the joint {name} {why}; --fix is for the joints outside the chain", field="--fix"
            )
        low, high = every[name].lower, every[name].upper
        if low is None or high is None or low >= high:
            low, high = -MAX_FIXED_POSITION, MAX_FIXED_POSITION
        if not low - 1e-6 <= value <= high + 1e-6:
            raise InvalidRequest(
                f"{robot.source.path}: {name}={value:g} is outside of the joint's limits, {low:g} to {high:g}; choose a position within",
                field="--fix",
            )


def _unheeded(
    stands: Mapping[str, float], positions: Mapping[str, float], every: Mapping[str, Joint], moving: Collection[str]
) -> Iterator[str]:
    """Which joints that stand still are not where their <mimic> has them, and why."""
    for name in stands:
        if name in positions or not (copied := every[name].mimic) or (copied[0] in every and copied[0] not in moving):
            continue
        why = "which is not in the file; correct <mimic>"
        if copied[0] in moving:
            why = "which moves with the arm, so what it carries is not where the planner takes it to be"
        yield f"{name}: it mimics {copied[0]}, {why}; here it stands at {stands[name]:g}, or where --fix has it"


def _outwards(robot: Description, base: str, order: Sequence[str]) -> list[str]:
    """Links in the order: the base, then what it carries, then what it stands on."""
    below = set(robot.below(base))
    return [
        base,
        *(link for link in order if link in below and link != base),
        *(link for link in order if link not in below),
    ]
