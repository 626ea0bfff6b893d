"""The grippers of a robot: their queries, and the states they publish."""

from __future__ import annotations

import logging
import secrets
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from zarm_contract.errors import Busy, ExecutionRefused, InvalidRequest, Unavailable
from zarm_contract.keys import Keys
from zarm_contract.messages import (
    Accepted,
    GripperCancel,
    GripperRequest,
    GripperState,
    JointState,
    Openings,
    PlannedGrip,
)
from zarm_contract.robot import RobotDescription
from zarm_contract.strategies import DRIVER_STRATEGIES, EXECUTORS
from zarm_executor.grip_stop import GripStop
from zarm_executor.gripper_control import GripperControl
from zarm_executor.gripper_links import DrivenGripper, EmulatedGripper
from zarm_executor.machine import Machine
from zarm_executor.member_gripper import MemberGripper
from zarm_runtime import clock
from zarm_runtime.bus import Bus
from zarm_runtime.state_file import StateFile

log = logging.getLogger(__name__)

PERIOD = 0.02
"""Period (s) at which grippers are watched."""
_PROGRESS_PERIOD = 0.05
"""Interval (s) at which the state of a moving gripper is published."""
_OPENING_THRESHOLD = 2e-4
"""The opening at rest is published when it has changed by more than this (m)."""
_AS_PLANNED = 0.0015
"""By how much (m) an opening may differ from the one that a plan was verified with, which is rounded to 1 mm."""


class Grippers:
    """All grippers of a robot; it may have none. Thread-safe.

    A gripper stands while the robot follows a plan that was verified before the motion, with the opening that it had, unless a
    servo checks the rest of the motion with what is measured.
    """

    def __init__(
        self, robot: RobotDescription, machine: Machine, bus: Bus, keys: Keys, file: StateFile[JointState]
    ) -> None:
        descriptor = robot.descriptor
        self._machine, self._keys, self._file = machine, keys, file
        self._grippers = descriptor.grippers
        self._states = bus.latched(keys.gripper_state("*"))
        saved = file.load()
        kept = {} if saved is None else dict(zip(saved.joint_names, saved.position, strict=True))
        self._emulated = {
            name: EmulatedGripper(kept.get(gripper.joint, gripper.positions[-1]))
            for name, gripper in self._grippers.items()
        }
        self._driven = {
            name: DrivenGripper(bus, keys, name, gripper)
            for name, gripper in (self._grippers.items() if descriptor.strategy_params is not None else ())
        }
        self._of_members = {
            name: MemberGripper(bus, led.robot, name.removeprefix(f"{group}_"), gripper)
            for group, led in descriptor.executors.items()
            for name, gripper in self._grippers.items()
            if name.startswith(f"{group}_")
        }
        self._controls = {
            name: GripperControl(name, gripper, None, gripper.touch_links(robot.urdf))
            for name, gripper in self._grippers.items()
        }
        self._starting = threading.Lock()
        self._publishing = threading.Lock()
        self._published: dict[str, tuple[GripperState, float]] = {}
        self._stopped = 0.0
        self._ticked = clock.monotonic()
        self.switch(machine.state().strategy)

    def __bool__(self) -> bool:
        return bool(self._controls)

    # -- commands --

    def move(self, request: GripperRequest, arrival: float) -> Accepted:
        """Start to move a gripper. Raises a ZarmError, and then nothing has moved."""
        control = self._controls[self._named(request.gripper)]
        goal_id = request.goal_id or f"grip-{secrets.token_hex(4)}"
        with self._starting:
            if arrival < self._stopped:
                raise Busy("a stop came after this request; send it again")
            state = self._machine.state()
            if state.mode == "fault":
                raise Busy("the executor is in fault, and nothing moves; reset it (executor/reset), then try again")
            if (goal := self._machine.unchecked_plan()) is not None:
                raise Busy(
                    f"the robot follows {goal}, which was checked with the fingers where they are; move them when it has ended, or start "
                    "a servo, which checks the rest of a motion"
                )
            control.start(request, goal_id)
        self.publish()
        return Accepted(goal_id=goal_id)

    def cancel(self, request: GripperCancel) -> GripperState:
        """Stop a gripper where it is. Raises InvalidRequest for one that is not there."""
        name = self._named(request.gripper)
        self._controls[name].cancel("the goal was cancelled by a client")
        self.publish()
        return self._controls[name].state()

    def stop(self, arrival: float) -> None:
        """Stop every gripper where it is; those that hold something go on holding it."""
        with self._starting:
            self._stopped = max(self._stopped, arrival)
        self._cancel_all("the robot was stopped by a client")

    def switch(self, strategy: str) -> None:
        """From now on move them as this strategy moves the robot."""
        self._cancel_all(f"the strategy was switched to {strategy}")
        for name, control in self._controls.items():
            if strategy == "emulator":
                control.switch(self._emulated[name])
            elif strategy == EXECUTORS:
                control.switch(self._of_members.get(name))
            else:
                control.switch(self._driven.get(name) if strategy in DRIVER_STRATEGIES else None)

    def _cancel_all(self, why: str) -> None:
        for control in self._controls.values():
            control.cancel(why)
        self.publish()

    @contextmanager
    def as_planned(self, what: str, openings: Openings) -> Iterator[None]:
        """A block in which no gripper starts to move. Raises Busy if one moves, and ExecutionRefused if its opening is unknown
        (`no_joint_state`) or differs from the one that `what` was verified with (`stale_plan`).
        """
        with self._starting:
            for opening in openings:
                self._demand(what, self._named(opening.gripper), opening.width)
            yield

    def _demand(self, what: str, name: str, planned: float) -> None:
        state = self._controls[name].state()
        if not state.done:
            raise Busy(f"{name} moves for {state.goal_id}; plan and execute when that has ended")
        if state.width is None:
            raise ExecutionRefused(
                f"the opening of {name} is not known, as nothing reports {self._grippers[name].joint}; start the driver of the gripper",
                code="no_joint_state",
            )
        if abs(state.width - planned) > _AS_PLANNED:
            raise ExecutionRefused(
                f"{what} was verified with {name} at {planned:g} m, which is at {state.width:.3f} m now; plan again",
                code="stale_plan",
            )

    def stop_at(self, until: float, grip: PlannedGrip) -> GripStop:
        """A stop of a goal before the path time `until` (s). Raises InvalidRequest for a gripper that is not there."""
        return GripStop(until, grip, self._controls[self._named(grip.gripper)])

    def check_idle(self) -> None:
        """Raises Busy while a gripper moves."""
        for name, control in self._controls.items():
            if control.moving:
                raise Busy(f"the gripper {name} moves; let its goal end, and try again")

    def _named(self, name: str | None) -> str:
        known = ", ".join(self._controls)
        if not known:
            raise InvalidRequest(
                "this robot has no gripper; describe it in `grippers` of its descriptor", field="gripper"
            )
        if name is None:
            if len(self._controls) > 1:
                raise InvalidRequest(f"this robot has several grippers, {known}; name one", field="gripper")
            return known
        if name not in self._controls:
            raise InvalidRequest(f"there is no gripper {name}; this robot has {known}", field="gripper")
        return name

    # -- the loop --

    def tick(self, now: float) -> None:
        """One period at `now` (s, monotonic)."""
        dt, self._ticked = now - self._ticked, now
        for control in self._controls.values():
            control.tick(now, max(dt, 0.0))
        self.publish()

    def publish(self) -> None:
        """Publish what has changed."""
        with self._publishing:
            for name, control in self._controls.items():
                self._publish(name, control.state(), clock.monotonic())

    def _publish(self, name: str, state: GripperState, now: float) -> None:
        before = self._published.get(name)
        if before is not None:
            last, at = before
            same = {"width": last.width, "position": last.position}
            if state.model_copy(update=same) == last and (
                _near(state.width, last.width) if state.done else now - at < _PROGRESS_PERIOD
            ):
                return
        self._published[name] = state, now
        self._states.set(state, key=self._keys.gripper_state(name))
        if before is None or (before[0].status, before[0].goal_id) != (state.status, state.goal_id):
            reason = "" if state.problem is None else f" reason={state.problem.message}"
            log.info("gripper gripper=%s status=%s goal_id=%s%s", name, state.status, state.goal_id, reason)
            if state.done:
                self._save()

    def _save(self) -> None:
        """Keep where the emulated fingers are."""
        names = tuple(gripper.joint for gripper in self._grippers.values())
        positions = tuple(emulated.position for emulated in self._emulated.values())
        try:
            self._file.save(
                JointState(stamp=clock.unix_time(), joint_names=names, position=positions, velocity=(0.0,) * len(names))
            )
        except Unavailable as error:
            log.warning("the emulated grippers are not saved reason=%s", error)


def _near(one: float | None, other: float | None) -> bool:
    return one == other if one is None or other is None else abs(one - other) <= _OPENING_THRESHOLD
