"""Whether a plan is inside a policy: the whole arm, its speed and that of its tip, between samples too."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from zarm_contract.errors import ExecutionRefused
from zarm_contract.messages import Attached, Plan
from zarm_geometry.gripper_openings import openings_of
from zarm_geometry.motion_check import MotionCheck
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_mcp.policy import Policy
from zarm_trajectory.arrays import Array
from zarm_trajectory.trajectory import TimedTrajectory

_SAMPLE = 0.01
"""Interval (s) of samples; the check allows for what lies between."""
_ROUNDING = 1.01


class PolicyCheck:
    """Checks plans for one robot."""

    def __init__(self, model: RobotModel, policy: Policy) -> None:
        self._model, self._policy = model, policy
        self._motions = MotionCheck(model)
        walls = policy.workspace.walls() if policy.workspace is not None else []
        self._motions.set_world(World([*walls, *policy.zones()], 0.0))
        self._fastest = np.array(model.robot.descriptor.cspace.velocity)

    def slower(self, plan: Plan, attached: Sequence[Attached] = ()) -> float:
        """The share of its speed at which a plan is inside the policy's speeds, with what is attached now; 1 if it is."""
        joints, tip = self._speeds(_motion(plan, self._model), attached)
        return min(1.0, self._policy.joint_speed / max(joints, 1e-9), self._policy.tool_speed / max(tip, 1e-9))

    def demand(self, plan: Plan, attached: Sequence[Attached] = ()) -> None:
        """Raise ExecutionRefused (`limit_violated`) unless a plan, with what is attached now, is inside the policy."""
        motion = _motion(plan, self._model)
        times = _times(motion)
        verdict = self._motions.check(
            times,
            motion.positions(times),
            margin=0.0,
            attached=attached,
            openings=openings_of(plan.openings),
            self_collision=False,
        )
        if not verdict.free:
            zone = verdict.object or ""
            where = f"enters {zone}" if zone.startswith("keep_out.") else f"leaves the workspace ({zone})"
            raise _refused(
                f"{verdict.link} {where} at {verdict.contact_time or 0.0:.2f} s; plan through poses that lead elsewhere"
            )
        joints, tip = self._speeds(motion, attached)
        if joints > self._policy.joint_speed * _ROUNDING:
            raise _refused(
                f"a joint moves at {joints:.2f} of its velocity limit (at most {self._policy.joint_speed:g})"
            )
        if tip > self._policy.tool_speed * _ROUNDING:
            raise _refused(f"the tip moves at {tip:.2f} m/s (at most {self._policy.tool_speed:g})")

    def _speeds(self, motion: TimedTrajectory, attached: Sequence[Attached]) -> tuple[float, float]:
        """The highest share of a joint's velocity limit, and the highest speed of the tip (m/s)."""
        times = _times(motion)
        states, model = motion.sample(times), self._model.with_tools(attached)
        tips: Array = np.array([model.fk_tip(position)[:3, 3] for position in states[0]])
        speeds = np.linalg.norm(np.diff(tips, axis=0), axis=1) / np.diff(times)
        return float((np.abs(states[1]) / self._fastest).max()), float(speeds.max(initial=0.0))


def _motion(plan: Plan, model: RobotModel) -> TimedTrajectory:
    return TimedTrajectory.of(plan.trajectory, model.robot.descriptor.joints)


def _times(motion: TimedTrajectory) -> Array:
    times = np.append(np.arange(motion.begin, motion.duration, _SAMPLE), motion.duration)
    return np.asarray(times[np.append(np.diff(times) > 1e-6, True)])


def _refused(why: str) -> ExecutionRefused:
    return ExecutionRefused(f"the policy does not allow it: {why}", code="limit_violated")
