"""Converts planning requests of clients."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

from sensor_msgs.msg import JointState as RosJointState

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import Goal, JointGoal, PathConstraint, Plan, Pose, PoseGoal, WaypointsGoal
from zarm_ros_bridge.convert.fields import finite
from zarm_ros_bridge.convert.poses import is_given, pose_of

MOST_SETS = 100
"""Most waypoints of one motion."""
MOST_POSES = 64
"""Most poses of one goal set."""

_AXES = ("theta_x", "theta_y", "theta_z", "x", "y", "z")


@dataclass(frozen=True)
class MotionRequest:
    """A motion to a goal that a client gave in `field`, from `start` (empty: from the robot's position).

    The goal is positions of the `joints` (rad), or `sets` of poses: one pose of each in turn, or with `any_set` one
    pose of any.
    """

    field: str
    start: RosJointState
    sets: tuple[tuple[Pose, ...], ...]
    any_set: bool
    constraint: PathConstraint | None
    joints: tuple[float, ...] = ()

    @classmethod
    def to_joints(cls, field: str, request: Any, joints: Sequence[str], constraint: PathConstraint | None) -> Self:
        """A motion to the `target_joint_positions` of a request, one for each of `joints`. Raises InvalidRequest."""
        values = request.target_joint_positions
        if len(values) != len(joints):
            raise InvalidRequest(
                f"{len(values)} positions for the {len(joints)} joints {', '.join(joints)}; give one for each, in this order",
                field=field,
            )
        positions = tuple(finite(value, f"{field}[{i}]") for i, value in enumerate(values))
        return cls(field, request.start_pose, (), False, constraint, positions)

    @property
    def goal(self) -> Goal:
        """The goal on the bus. Raises InvalidRequest for a goal set that is too large."""
        if self.joints:
            return JointGoal(kind="joints", position=self.joints)
        if self.any_set:
            return self._goal_set([pose for poses in self.sets for pose in poses])
        goals = tuple(map(self._goal_set, self.sets))
        return goals[0] if len(goals) == 1 else WaypointsGoal(kind="waypoints", through=goals)

    def _goal_set(self, poses: Sequence[Pose]) -> PoseGoal:
        if len(poses) > MOST_POSES:
            raise InvalidRequest(
                f"{len(poses)} poses to choose from are more than {MOST_POSES}; leave some out", field=self.field
            )
        first, *others = poses
        return PoseGoal(kind="pose", position=first.position, orientation=first.orientation, alternatives=tuple(others))

    def reached(self, plan: Plan) -> str:
        """The goal as the client knows it: its field, and the index if there were several poses to choose from."""
        place = plan.selected_goal_index
        choice = self.any_set or any(len(poses) > 1 for poses in self.sets[-1:])
        if place is None or not choice:
            return self.field
        if self.field == "target_poses":
            return f"target_poses[{place}]"
        chosen = self.selected(plan, [0] * (len(self.sets) - 1))
        last = max(range(len(chosen)), key=lambda i: (chosen[i] >= 0, i))
        return f"{self.field}[{last}].poses[{chosen[last]}]"

    def selected(self, plan: Plan | None, passed: Sequence[int] = ()) -> list[int]:
        """The index of the pose reached in each goal set; -1 for a set of which none is.

        `passed` are the indices in the sets before the last one, which the plan does not report.
        """
        places = [-1] * len(self.sets)
        if plan is None or plan.selected_goal_index is None or not places:
            return places
        place = plan.selected_goal_index
        if not self.any_set:
            return [*passed, place]
        for index, poses in enumerate(self.sets):
            if place < len(poses):
                places[index] = place
                break
            place -= len(poses)
        return places


def filled(request: Any, fields: Sequence[str]) -> list[str]:
    """Those of the fields in which the client gave a goal."""
    return [field for field in fields if _is_filled(getattr(request, field))]


def _is_filled(value: Any) -> bool:
    return bool(len(value)) if hasattr(value, "__len__") else is_given(value)


def motion_to(given: Sequence[str], reads: Mapping[str, str], planner: str, default: str = "target_pose") -> str:
    """The filled-in field that is the goal: the one that the active planner reads, or the only one there is.

    Raises InvalidRequest if none is filled in, or if two are possible.
    """
    wanted = reads.get(planner, default)
    if wanted in given:
        return wanted
    if not given:
        raise InvalidRequest(f"there is no goal; fill in {wanted}, which the planner {planner} reads", field=wanted)
    if len(given) > 1:
        raise InvalidRequest(
            f"{' and '.join(given)} are filled in, and {wanted}, which the planner {planner} reads, is not; fill in one goal "
            "alone, or choose another planner with set_planner",
            field=given[0],
        )
    return given[0]


def pose_sets(sets: Sequence[Sequence[Any]], field: str) -> tuple[tuple[Pose, ...], ...]:
    """The poses of each set; `field` is the list of them, or the one pose. Raises InvalidRequest."""
    if len(sets) > MOST_SETS:
        raise InvalidRequest(f"{len(sets)} poses are more than {MOST_SETS}; ask for the motion in parts", field=field)
    for i, poses in enumerate(sets):
        if not len(poses):
            raise InvalidRequest("the goal set has no pose; give one, or several to choose from", field=f"{field}[{i}]")
    places = places_of(sets, field)
    return tuple(tuple(pose_of(pose, next(places)) for pose in poses) for poses in sets)


def places_of(sets: Sequence[Sequence[Any]], field: str) -> Iterator[str]:
    """The client's name for each of the poses: target_pose, target_poses[2], goalsets[0].poses[2]."""
    for i, poses in enumerate(sets):
        for j in range(len(poses)):
            if field == "goalsets":
                yield f"goalsets[{i}].poses[{j}]"
            else:
                yield field if field == "target_pose" else f"{field}[{i + j}]"


def path_constraint_of(
    whole: Sequence[int], each: Sequence[int], target: str, lists: Mapping[str, int]
) -> PathConstraint | None:
    """The components of the start pose of the tip that the whole motion to the field `target` keeps, in the base frame.

    `whole` are `trajectory_constraints`. `each` are `trajectories_contraints`, six for each of a list of goals; `lists`
    gives the field and the length of that list. Since a motion holds an axis throughout or not at all, they must be the
    same for all goals, and equal `whole` if both are given. Raises InvalidRequest.
    """
    ((name, count),) = lists.items()
    axes = _axes(whole, "trajectory_constraints")
    if len(axes) > 1:
        raise InvalidRequest(
            f"{6 * len(axes)} constraints; give six, for {', '.join(_AXES)}, or none", field="trajectory_constraints"
        )
    rows = _axes(each, "trajectories_contraints")
    if rows and any(map(any, rows)) and target != name:
        raise InvalidRequest(
            f"these are for {name}, and {target} is planned to; give trajectory_constraints",
            field="trajectories_contraints",
        )
    if target == name and rows:
        if len(rows) != count:
            raise InvalidRequest(
                f"constraints for {len(rows)} of {count} {name}; give six for each, or none",
                field="trajectories_contraints",
            )
        if len(set(rows + axes)) > 1:
            raise InvalidRequest(
                "the constraints differ from pose to pose, and a path constraint holds for the whole motion; give all poses the same, "
                "or ask for the motion in parts",
                field="trajectories_contraints",
            )
        axes = rows[:1]
    held = axes[0] if axes else (False,) * 6
    return PathConstraint(axes=held) if any(held) else None


def _axes(values: Sequence[int], field: str) -> list[tuple[bool, bool, bool, bool, bool, bool]]:
    rest = len(values) % 6
    if rest:
        raise InvalidRequest(
            f"{len(values)} constraints are not a multiple of six; give {', '.join(_AXES)} for each", field=field
        )
    for i, value in enumerate(values):
        if value not in (0, 1):
            raise InvalidRequest(f"{value} is neither 0 (free) nor 1 (constrained)", field=f"{field}[{i}]")
    rows = [tuple(bool(value) for value in values[i : i + 6]) for i in range(0, len(values), 6)]
    return [(a, b, c, d, e, f) for a, b, c, d, e, f in rows]
