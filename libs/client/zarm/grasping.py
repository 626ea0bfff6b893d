"""Pick and place: a gripper, a grasp given by the user, and straight ways to and from it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager

from zarm.calls import Calls
from zarm.connection import Connection
from zarm.executor import Executor
from zarm.gripper import Gripper
from zarm.motions import Line, Move, Offset, goal_of
from zarm.planner import Planner
from zarm.scene import Scene
from zarm.values import PathConstraint, Pose
from zarm_contract import messages
from zarm_contract.errors import ExecutionFailed, InvalidRequest, ZarmError, from_problem
from zarm_contract.messages import GripperState

_APPROACH = 0.1
_CLOSED = 0.002
"""Fingers that are no further apart than this (m) when they stand hold nothing."""

Grasp = messages.Pose | messages.PoseGoal


class Grasping(Calls):
    """Picks objects of the scene up, and places them."""

    def __init__(
        self, connection: Connection, planner: Planner | None = None, executor: Executor | None = None
    ) -> None:
        super().__init__(connection)
        self._planner = planner or Planner(connection)
        self._executor = executor or Executor(connection)
        self._gripper = Gripper(connection)
        self._scene = Scene(connection)

    def pick(
        self,
        item: str | None,
        grasp: Grasp,
        *,
        gripper: str | None = None,
        open_to: float | None = None,
        width: float | None = None,
        force: float | None = None,
        approach: float = _APPROACH,
        lift: float = _APPROACH,
        touch: Iterable[str] = (),
        group: str | None = None,
        mass: float | None = None,
    ) -> GripperState:
        """Grasp the object `item` of the scene, attach it to the robot and lift it. Returns the state of the gripper. With None it is whichever
        of the objects in `touch` the fingers have closed on.

        `grasp` is where the tip closes the gripper: a pose, one with freedom (`zarm.PoseGoal`), or `zarm.AnyOf` several. The steps are
        reach (the last `approach` m straight along the tool's z, with the gripper open, or `open_to` m), close, attach, and lift (`lift`
        m straight up). The gripper closes until something stops the fingers, or to `width` (m), with at most `force` (N). The
        object, which may touch fingers and palm from then on, and what it rests on may be touched on the way, and objects named in
        `touch`. With its `mass` (kg) plans keep the largest torques of the joints. Of a robot with several arms name the `group`, and the `gripper` that it carries.

        Each motion is verified before it starts, and the way there before the fingers move. Raises the error of the step that
        fails, which the message names, and ExecutionFailed if the fingers close on nothing; then the robot stands where that step
        began or ended.
        """
        allowed = (*touch,) if item is None else (item, *touch)
        sought = item or "what is there"
        with self._step("reach", sought):
            self._demand_known(item, allowed)
            goal = _pose_goal(grasp, "grasp")
            if goal.approach is None:
                goal = goal.model_copy(update={"approach": Offset(approach, (0.0, 0.0, 1.0), touch=allowed)})
            openings = self._opening(gripper, open_to)
            plan = self._planner.plan(goal, openings=openings, group=group)
            self._open(openings)
            self._executor.execute(plan)
        with self._step("close", sought):
            held = self._close(gripper, width, force)
        with self._step("attach", sought):
            link = held.touch_links[-1] if group is not None else None
            name = self._gripped(held, allowed) if item is None else item
            self._scene.attach(name, touch_links=held.touch_links, link=link, mass=mass)
        with self._step("lift", name):
            beside = (one for one in allowed if one != name)
            self._rise(group, (0.0, 0.0, lift), (*beside, *self._beneath(name)))
        return held

    def place(
        self,
        goal: Grasp,
        *,
        item: str | None = None,
        gripper: str | None = None,
        open_to: float | None = None,
        approach: float = _APPROACH,
        retreat: float = _APPROACH,
        upright: bool = False,
        touch: Iterable[str] = (),
        group: str | None = None,
    ) -> GripperState:
        """Put the object `item`, by default the only one that is attached, down with the tip at `goal`, and go back. Returns the state
        of the gripper.

        `goal` is as in `pick`. The steps are carry (to `approach` m above the goal, around what comes into the way; with `upright` the tip keeps its tilt on the
        way), lower, open (to `open_to` m, by default as far as it goes), detach, and retreat (`retreat` m back along the tool's z).
        Objects named in `touch`, such as what it is put on, may be touched while it is lowered. `group` is as in `pick`.

        Each motion is verified before it starts, and the way back before the fingers open. Raises the error of the step that fails,
        which the message names; then the robot stands where that step began or ended.
        """
        attached = self._scene.attached()
        if item is None and len(attached) != 1:
            carried = ", ".join(attached) or "nothing"
            raise InvalidRequest(f"the robot carries {carried}; name the object to place", field="item")
        name = item if item is not None else next(iter(attached))
        if name not in attached:
            carried = ", ".join(attached) or "nothing"
            raise InvalidRequest(f"the robot does not carry {name}, but {carried}", field="item")
        allowed = tuple(touch)
        with self._step("carry", name):
            above = _raised(_pose_goal(goal, "goal"), approach)
            constraint = PathConstraint(("theta_x", "theta_y")) if upright else None
            self._executor.execute(self._planner.plan(above, path_constraint=constraint, group=group), replan=True)
        with self._step("lower", name):
            self._rise(group, (0.0, 0.0, -approach), allowed)
        with self._step("open", name):
            openings = self._opening(gripper, open_to)
            touched = (*allowed, *self._beneath(name))
            self._line(group, (0.0, 0.0, -retreat), touched, frame="tool", openings=openings)
            state = self._open(openings)
        with self._step("detach", name):
            self._scene.detach(name)
        with self._step("retreat", name):
            self._rise(group, (0.0, 0.0, -retreat), (name, *allowed), frame="tool")
        return state

    def _demand_known(self, item: str | None, allowed: Sequence[str]) -> None:
        """Raises InvalidRequest unless what is to be picked is in the scene."""
        objects = self._scene.objects()
        if item is not None and item not in objects:
            known = ", ".join(objects) or "none"
            raise InvalidRequest(f"there is no object {item} in the scene, which holds {known}", field="item")
        if not allowed:
            raise InvalidRequest("name the object, or in `touch` those that may be there", field="item")

    def _gripped(self, held: GripperState, allowed: Sequence[str]) -> str:
        """The one of the `allowed` objects that the fingers touch, by the nearest pair of the check. Raises ExecutionFailed if there is none."""
        (found,) = self._planner.check()
        pair = set(found.pair or ())
        names = pair & {*allowed}
        if not names or not pair & {*held.touch_links}:
            raise ExecutionFailed(
                f"the fingers touch none of {', '.join(allowed)}; see what they have closed on",
                code="tolerance_violated",
            )
        return names.pop()

    def _opening(self, gripper: str | None, width: float | None) -> dict[str, float]:
        """The gripper with the opening that it shall have, by default the widest."""
        state = self._gripper.state(gripper)
        return {state.gripper: state.widths[1] if width is None else width}

    def _open(self, openings: Mapping[str, float]) -> GripperState:
        ((gripper, width),) = openings.items()
        return self._gripper.move(width, gripper)

    def _close(self, gripper: str | None, width: float | None, force: float | None) -> GripperState:
        held = (
            self._gripper.close(gripper, force=force)
            if width is None
            else self._gripper.move(width, gripper, force=force)
        )
        closed = held.width is not None and held.width <= held.widths[0] + _CLOSED
        if closed or (held.status == "reached" and width is None):
            raise ExecutionFailed(
                "the fingers have closed on nothing; see where the object is", code="tolerance_violated"
            )
        return held

    def _beneath(self, item: str) -> tuple[str, ...]:
        """What an attached object rests on: the object that it is nearest to."""
        (found,) = self._planner.check()
        if found.pair is None or item not in found.pair or found.clearance > self._planner.settings().margin:
            return ()
        (other,) = set(found.pair) - {item}
        return (other,) if other in self._scene.objects() else ()

    def _rise(self, group: str | None, offset: messages.Vector3, touch: tuple[str, ...], frame: str = "base") -> None:
        """Move straight by an offset (m) in the frame of the base, or of the tool."""
        self._executor.execute(self._line(group, offset, touch, frame))

    def _line(
        self,
        group: str | None,
        offset: messages.Vector3,
        touch: tuple[str, ...],
        frame: str = "base",
        openings: Mapping[str, float] | None = None,
    ) -> messages.Plan:
        tip = self._planner.fk([self._executor.joint_state().position], group=group)[0]
        along = _turned(tip.orientation, offset) if frame == "tool" else offset
        moved = Pose(_sum(tip.position, along), tip.orientation)
        return self._planner.plan_program([Move(Line(moved), touch=touch, group=group)], openings=openings)

    @contextmanager
    def _step(self, step: str, item: str) -> Iterator[None]:
        """Errors in this block name the step."""
        try:
            yield
        except ZarmError as error:
            named = f"{step} {item}: {error.problem.message}"
            raise from_problem(error.problem.model_copy(update={"message": named})) from error


def _pose_goal(goal: Grasp, field: str) -> messages.PoseGoal:
    made = goal_of(goal)
    if not isinstance(made, messages.PoseGoal):
        raise InvalidRequest("give a zarm.Pose, a zarm.PoseGoal or zarm.AnyOf several", field=field)
    return made


def _raised(goal: messages.PoseGoal, height: float) -> messages.PoseGoal:
    """A pose goal `height` m above this one."""
    up = (0.0, 0.0, height)
    return goal.model_copy(
        update={
            "position": _sum(goal.position, up),
            "alternatives": tuple(
                pose.model_copy(update={"position": _sum(pose.position, up)}) for pose in goal.alternatives
            ),
        }
    )


def _turned(orientation: messages.Quaternion, vector: tuple[float, float, float]) -> tuple[float, float, float]:
    """A vector in the frame of this orientation (x, y, z, w), in the base frame: v + 2 q x (q x v + w v)."""
    *q, w = orientation
    inner = [one + w * part for one, part in zip(_cross(q, vector), vector, strict=True)]
    x, y, z = (part + 2.0 * one for part, one in zip(vector, _cross(q, inner), strict=True))
    return (x, y, z)


def _cross(a: Sequence[float], b: Sequence[float]) -> tuple[float, float, float]:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def _sum(one: tuple[float, float, float], other: tuple[float, float, float]) -> tuple[float, float, float]:
    return (one[0] + other[0], one[1] + other[1], one[2] + other[2])
