"""compute_fk, compute_ik, check_state_validity and check_multi_state_validity."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from geometry_msgs.msg import PoseStamped, Vector3
from moveit_msgs.msg import ConstraintEvalResult, ContactInformation
from moveit_msgs.msg import MoveItErrorCodes as Val

from zarm_contract.errors import PlanningFailed
from zarm_contract.messages import CheckResult, IkRequest, Pose, TipFrame
from zarm_geometry.frames import pose_of
from zarm_ros_bridge.convert.joints import known_as, positions_of
from zarm_ros_bridge.convert.poses import pose_of as ros_pose_of
from zarm_ros_bridge.convert.poses import ros_pose
from zarm_ros_bridge.convert.times import ros_time
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.frames import Frames
from zarm_ros_bridge.moveit.arm_groups import ArmGroup, ArmGroups, arm_of
from zarm_ros_bridge.moveit.constraint_set import ConstraintSet
from zarm_ros_bridge.moveit.error_codes import Refusal
from zarm_ros_bridge.moveit.states import Positions, robot_state, start_of

_SECONDS = 65.0
"""Longest wait (s) for a batch, for which the planner allows 60 s."""
_BATCH = 1000  # most states in one request
_SOLUTIONS_PER_ARM = 12
"""Solutions of each arm, among which those are sought that go together."""


class _Wanted(NamedTuple):
    """The pose of a link, None for the tip, that the joints of a group are to reach."""

    group: ArmGroup
    pose: Pose
    tip: TipFrame | None


class Kinematics:
    """Answers for states that a request gives. Thread-safe."""

    def __init__(self, engine: Engine, frames: Frames, groups: ArmGroups) -> None:
        self._engine = engine
        self._frames = frames
        self._groups = groups

    def fk(self, request: Any, response: Any) -> None:
        """Fill in the poses of the links, in the frame of the request. Raises Refusal, UnknownFrame."""
        links = self._frames.links
        at = links.poses(self._state(request.robot_state))
        names = list(request.fk_link_names) or [self._engine.tooled.descriptor.tip_link]
        frame = self._frames.pose_of(request.header.frame_id)
        into = np.eye(4) if frame is None else np.linalg.inv(frame)
        poses = []
        for i, name in enumerate(names):
            link = known_as(name, links.links)
            if link not in at:
                raise Refusal(
                    Val.INVALID_LINK_NAME,
                    f"the robot has no link {name!r}; choose among {', '.join(links.links)}",
                    f"fk_link_names[{i}]",
                )
            stamped = PoseStamped(pose=ros_pose(pose_of(into @ at[link])))
            stamped.header.frame_id = request.header.frame_id or links.base
            stamped.header.stamp = request.header.stamp
            poses.append(stamped)
        response.pose_stamped, response.fk_link_names = poses, names

    def ik(self, request: Any, response: Any) -> None:
        """Fill in joints for a pose, or for one of each of several arms. Raises Refusal, UnknownFrame, and PlanningFailed without a solution."""
        asked = request.ik_request
        wanted = self._wanted(asked, self._groups.of(asked.group_name))
        near = self._state(asked.robot_state)
        limits = ConstraintSet(asked.constraints, self._engine, self._frames, "ik_request.constraints")
        if len(wanted) == 1:
            states = self._solutions(wanted[0], near, 64 if limits else 1, collision_free=asked.avoid_collisions)
        else:
            states = self._together(wanted, near, collision_free=asked.avoid_collisions)
        solution = next((state for state in states if not limits or limits.holds(state)), None)
        if solution is None:
            raise PlanningFailed(
                f"no joints within their ranges reach the pose{'s' if len(wanted) > 1 else ''}"
                + (" free of collision" if asked.avoid_collisions else "")
                + (" and keep the constraints" if limits else ""),
                code="unreachable",
                field="ik_request",
            )
        response.solution = robot_state(self._engine.joints, solution)
        response.solution.joint_state.header.stamp = ros_time(0.0)

    def _solutions(self, wanted: _Wanted, near: Positions, count: int, *, collision_free: bool) -> list[Positions]:
        """Joints of the robot that reach one pose, nearest first."""
        group, pose, tip = wanted
        asked = IkRequest(
            poses=(pose,), tip=tip, group=group.name, near=near, max_solutions=count, collision_free=collision_free
        )
        return [group.whole(joints, near) for joints in self._engine.client.request_ik(asked).solutions[0]]

    def _together(self, wanted: Sequence[_Wanted], near: Positions, *, collision_free: bool) -> list[Positions]:
        """Joints of the robot that reach the poses of all arms, nearest first. The arms may be in each other's way, so that each offers a few."""
        offers = [
            [one.group.part(state) for state in self._solutions(one, near, _SOLUTIONS_PER_ARM, collision_free=False)]
            for one in wanted
        ]
        states = []
        for chosen in itertools.product(*offers):
            state = near
            for one, part in zip(wanted, chosen, strict=True):
                state = one.group.whole(part, state)
            states.append(state)
        states.sort(key=lambda state: float(np.abs(np.subtract(state, near)).max()))
        if not collision_free or not states:
            return states
        results = self._engine.client.check(states[:_BATCH], timeout=_SECONDS)
        return [state for state, result in zip(states, results, strict=False) if not result.in_collision]

    def check(self, request: Any, response: Any) -> None:
        """Fill in whether a state is valid, and what it touches. Raises Refusal."""
        self._check_group(request.group_name)
        self._validate(request, response, [self._state(request.robot_state)])

    def check_all(self, request: Any, response: Any) -> None:
        """Fill in whether all states are valid, and what the first invalid one touches. Raises Refusal."""
        self._check_group(request.group_name)
        states = [
            positions_of(state, self._engine.joints, f"joint_states[{i}]")
            for i, state in enumerate(request.joint_states)
        ]
        self._validate(request, response, states or [self._state(request.robot_state)])

    def _check_group(self, name: str) -> None:
        if name:  # without one, the whole robot is meant
            self._groups.of(name)

    def _validate(self, request: Any, response: Any, states: Sequence[Positions]) -> None:
        constraints = ConstraintSet(request.constraints, self._engine, self._frames, "constraints")
        results = [
            result
            for i in range(0, len(states), _BATCH)
            for result in self._engine.client.check(states[i : i + _BATCH], points=True, timeout=_SECONDS)
        ]
        response.valid = True
        for state, result in zip(states, results, strict=True):
            evaluated = list(constraints.evaluate(state))
            valid = result.within_limits and not result.in_collision and all(holds for holds, _ in evaluated)
            if response.valid:
                response.constraint_result = [ConstraintEvalResult(result=a, distance=b) for a, b in evaluated]
                response.contacts = [self._contact(result)] if result.in_collision else []
            response.valid = response.valid and valid

    def _contact(self, result: CheckResult) -> Any:
        scene = self._engine.client.scene.read()
        attached = {one.object.name for one in scene.attached}
        first, second = result.pair or ("", "")
        contact = ContactInformation(contact_body_1=first, contact_body_2=second, depth=max(-result.clearance, 0.0))
        contact.header.frame_id = self._frames.links.base
        contact.body_type_1, contact.body_type_2 = (
            ContactInformation.ROBOT_LINK
            if name in self._frames.links.links
            else ContactInformation.ROBOT_ATTACHED
            if name in attached
            else ContactInformation.WORLD_OBJECT
            for name in (first, second)
        )
        if result.points is not None:
            a, b = (np.array(point) for point in result.points)
            contact.position.x, contact.position.y, contact.position.z = ((a + b) / 2.0).tolist()
            if (length := float(np.linalg.norm(b - a))) > 1e-9:
                x, y, z = ((b - a) / length).tolist()
                contact.normal = Vector3(x=x, y=y, z=z)
        return contact

    def _wanted(self, asked: Any, group: ArmGroup) -> list[_Wanted]:
        """The poses that are asked for, and of which link each is. Raises Refusal."""
        if asked.pose_stamped_vector:
            poses = list(asked.pose_stamped_vector)
            names = list(asked.ik_link_names) or [""]
        else:
            poses, names = [asked.pose_stamped], [*asked.ik_link_names[:1]] or [asked.ik_link_name]
        if len(poses) != len(names):
            raise Refusal(
                Val.INVALID_GOAL_CONSTRAINTS,
                f"{len(names)} links for {len(poses)} poses; name the link of each in ik_link_names",
                "ik_request.pose_stamped_vector",
            )
        wanted = [self._one_wanted(name, stamped, group) for name, stamped in zip(names, poses, strict=True)]
        if len({one.group.name for one in wanted}) < len(wanted):
            raise Refusal(
                Val.INVALID_GOAL_CONSTRAINTS, "one link of each arm has a pose, not two", "ik_request.ik_link_names"
            )
        return wanted

    def _one_wanted(self, name: str, stamped: Any, group: ArmGroup) -> _Wanted:
        links = self._frames.links
        link = known_as(name, links.links) or group.robot.descriptor.tip_link
        if link not in links.links:
            raise Refusal(
                Val.INVALID_LINK_NAME,
                f"the robot has no link {name!r}; choose among {', '.join(links.links)}",
                "ik_request.ik_link_name",
            )
        if arms := group.arms:
            group = self._groups.of(arm_of(link, arms, "ik_request.ik_link_name"))
        pose = self._frames.in_base(
            ros_pose_of(stamped.pose, "ik_request.pose_stamped.pose"), stamped.header, "ik_request.pose_stamped.header"
        )
        return _Wanted(group, pose, None if link == group.robot.descriptor.tip_link else TipFrame(link=link))

    def _state(self, state: Any) -> Positions:
        given = start_of(state, self._frames, self._engine.joints, "robot_state")
        return self._frames.joints() if given is None else given
