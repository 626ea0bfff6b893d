"""A twin with physics, which makes each motion before the robot does."""

from __future__ import annotations

import time
from collections.abc import Mapping
from collections.abc import Set as AbstractSet

import numpy as np

from zarm.connection import Connection
from zarm.robot import Robot
from zarm_contract.errors import ExecutionRefused, Unavailable, ZarmError
from zarm_contract.messages import (
    Attached,
    AttachObject,
    DetachObject,
    GripperState,
    Joints,
    LoadScene,
    PhysicsState,
    Plan,
    Scene,
    SceneEdit,
    SceneObject,
)
from zarm_geometry.frames import matrix, pose_of

_SILENCE = 3.0
"""s without a state after which no physics runs."""
_SETTLING = 5.0
"""Longest wait (s) for drives that settle."""
_START_TOLERANCE = 0.002
"""rad or m from the start of a motion within which it is made from there; the executor goes to the start first."""
_REST_VELOCITY = 0.005
"""rad/s or m/s of a joint that rests,"""
_RESTING = 1.0
"""and for how long (s): a change of the scene comes to the physics some tenths of a second later."""
_OPENING = 0.0005
"""m between the openings of two grippers that are open alike."""
_SLIGHT = 0.5
"""N that count as no contact: what rests on something else trembles."""


class Twin:
    """A simulation with physics of the same robot, on a bus of its own. `links` are those of the robot."""

    def __init__(self, connection: Connection, links: AbstractSet[str]) -> None:
        self._robot, self._links = Robot(connection), links

    def rehearse(self, plan: Plan, scene: Scene, grippers: Mapping[str, GripperState]) -> None:
        """Make the motion of a plan in a scene, with `grippers` as they are now. Raises ExecutionRefused that says what was touched, or why it failed, and Unavailable without a twin."""
        start = plan.trajectory.position[0]
        try:
            self._take_over(scene, start, grippers, _meant(plan))
            touched = self._touched_in(plan, {one.object.name for one in scene.attached})
        except Unavailable as error:
            raise Unavailable(f"the twin: {error}") from error
        except ZarmError as error:
            raise ExecutionRefused(f"the twin cannot make this motion: {error}; plan another one") from error
        if touched is not None:
            raise ExecutionRefused(f"in the twin {touched}; plan another motion, or correct the scene")

    def _take_over(
        self, scene: Scene, start: Joints, grippers: Mapping[str, GripperState], meant: AbstractSet[str]
    ) -> None:
        """Go to the start, in the scene, with what is attached there and grippers that are open as far; the guard passes over what is
        `meant` to be touched.
        """
        robot = self._robot
        self._await_rest()
        if robot.state().mode == "fault":  # from the motion before
            robot.reset()
        for name, held in robot.scene.attached().items():
            if held.tool is None:
                robot.scene.apply(SceneEdit(edit=DetachObject(op="detach", name=name)))
        mounted = robot.scene.read().tools
        for tool in set(mounted) - {*scene.tools}:
            robot.scene.unmount(tool)
        for tool in set(scene.tools) - {*mounted}:
            robot.scene.mount(tool)
        if passed_over := robot.scene.read().ignored_objects:
            robot.scene.set_object_collision(*passed_over, enabled=True)
        robot.scene.apply(SceneEdit(edit=LoadScene(op="load", objects=scene.objects)))
        self._await_rest()  # what it pressed on may be gone
        if not np.allclose(robot.joint_state().position, start, rtol=0.0, atol=_START_TOLERANCE):
            robot.execute(robot.plan(start))
        self._open_as(grippers)
        for one in scene.attached:
            if one.tool is not None:
                continue
            robot.scene.add(self._placed(one, start))
            attach = AttachObject(
                op="attach",
                name=one.object.name,
                link=one.link,
                touch_links=one.touch_links,
                mass=one.mass,
                center=one.center,
                joints=start,
            )
            robot.scene.apply(SceneEdit(edit=attach))
        there = {item.name for item in scene.objects}
        if passed_over := tuple(there & ({*scene.ignored_objects} | meant)):
            robot.scene.set_object_collision(*passed_over, enabled=False)
        self._await_rest()

    def _open_as(self, grippers: Mapping[str, GripperState]) -> None:
        """Open the grippers as far as those of the robot are."""
        here = self._robot.gripper.all()
        for name, there in grippers.items():
            width = here[name].width if name in here else None
            if there.width is not None and width is not None and abs(there.width - width) > _OPENING:
                low, high = there.widths
                self._robot.gripper.move(min(max(there.width, low), high), name)

    def _await_rest(self) -> None:
        """Wait until the drives have settled. Raises Unavailable if they do not."""
        began = moved = time.monotonic()
        for state in self._robot.joint_states():
            now = time.monotonic()
            if max(map(abs, state.velocity)) > _REST_VELOCITY:
                moved = now
            elif now > moved + _RESTING:
                return
            if now > began + _SETTLING:
                raise Unavailable(f"it does not come to rest within {_SETTLING:g} s; look at its drives")

    def _placed(self, one: Attached, q: Joints) -> SceneObject:
        """An attached object where it is with the robot at joints (rad)."""
        (link,) = self._robot.fk([q], tip=one.link) if one.link is not None else self._robot.fk([q])
        item = one.object
        turned = (0.0, 0.0, 0.0, 1.0) if item.kind == "sphere" else item.orientation
        pose = pose_of(matrix(link.position, link.orientation) @ matrix(item.position, turned))
        fields = {"position": pose.position, "orientation": pose.orientation}
        return item.model_copy(update=fields if item.kind != "sphere" else {"position": pose.position})

    def _touched_in(self, plan: Plan, carried: AbstractSet[str]) -> str | None:
        """What the robot, or what it carries, touches in the motion though the plan does not, if anything."""
        bus, keys = self._robot.connection.bus, self._robot.connection.keys
        moving = self._links | carried
        meant = _meant(plan)
        before = self._robot.connection.next(keys.physics_state, _SILENCE)
        if before is None:
            raise Unavailable("it has no physics; start it with `zarm up --driver physics`")
        known = {_pair(contact.first, contact.second) for contact in before.contacts}
        found: list[str] = []

        def watch(_: str, state: PhysicsState) -> None:
            for contact in state.contacts:
                pair = _pair(contact.first, contact.second)
                if contact.force > _SLIGHT and pair & moving and not pair <= moving | meant and pair not in known:
                    found.append(f"{contact.first} touches {contact.second} with {contact.force:.0f} N")

        end = bus.subscribe(keys.physics_state, watch)
        try:
            self._robot.execute(plan.trajectory)
        except ZarmError:
            if not found:
                raise
        finally:
            end()
        return found[0] if found else None


def _meant(plan: Plan) -> set[str]:
    """The objects that a plan may touch."""
    return {name for touch in plan.touches for name in touch.objects}


def _pair(first: str, second: str) -> frozenset[str]:
    return frozenset((first, second))
