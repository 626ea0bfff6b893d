"""What an agent can do with a robot: each method is one tool, whatever the protocol."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from zarm.connection import Connection
from zarm.grasping import Grasping
from zarm.motions import Line, Move
from zarm.robot import Robot
from zarm.values import Pose, made
from zarm_contract.errors import ExecutionRefused, InvalidRequest, ZarmError
from zarm_contract.messages import Cuboid, Cylinder, GoalState, Message, Plan, SceneObject, Sphere
from zarm_geometry.robot_model import RobotModel
from zarm_mcp.guarded import GuardedExecutor, GuardedPlanner
from zarm_mcp.plan_store import PlanStore
from zarm_mcp.policy import Policy, zone_name
from zarm_mcp.policy_check import PolicyCheck
from zarm_mcp.twin import Twin

Json = dict[str, Any]
DOWN = (1.0, 0.0, 0.0, 0.0)
"""The orientation (x, y, z, w) of a tip that points down."""
_KINDS: Mapping[str, type[Cuboid | Sphere | Cylinder]] = {"box": Cuboid, "sphere": Sphere, "cylinder": Cylinder}


class Agent:
    """The tools of an agent for the robot of `connection`, inside a policy; a `twin` makes each motion first. Every method raises a ZarmError that says what to do."""

    def __init__(self, connection: Connection, model: RobotModel, policy: Policy, twin: Twin | None = None) -> None:
        self._model, self._policy = model, policy
        self._robot = Robot(connection)
        check = PolicyCheck(model, policy)
        self._planner = GuardedPlanner(connection, policy, check)
        self._executor = GuardedExecutor(connection, check, twin)
        self._grasping = Grasping(connection, self._planner, self._executor)
        self._plans = PlanStore()
        self._added: set[str] = set()
        self._speed = self._fastest = 1.0  # what this agent has set, and may set

    def open(self) -> None:
        """Put the zones of the policy into the scene."""
        if zones := self._policy.zones():
            self._robot.scene.add(*zones, replace=True)

    def close(self) -> None:
        """Take them out."""
        present = self._robot.scene.objects()
        if zones := [zone_name(name) for name in self._policy.keep_out if zone_name(name) in present]:
            self._robot.scene.remove(*zones)

    def state(self) -> Json:
        """Mode, goal, joints, tip, speed, grippers, and the policy."""
        executor, joints = self._robot.state(), self._robot.joint_state()
        grippers = {name: self._robot.gripper.state(name).width for name in self._model.robot.descriptor.grippers}
        return {
            "mode": executor.mode,
            "goal_id": executor.goal_id,
            "problem": None if executor.problem is None else executor.problem.message,
            "joints": dict(zip(joints.joint_names, joints.position, strict=True)),
            "tip": _json(self._robot.tip()),
            "speed_scale": executor.speed_scale,
            "grippers": grippers,
            "policy": self._policy.model_dump(mode="json"),
        }

    def scene(self) -> Json:
        """The objects of the scene, and what is attached to the robot."""
        message = self._robot.scene.read()
        return {
            "objects": [_json(item) for item in message.objects],
            "attached": [_json(item) for item in message.attached],
        }

    def add_object(
        self, name: str, shape: str, size: list[float], position: list[float], orientation: list[float] | None
    ) -> Json:
        """Add a box, sphere or cylinder."""
        self._demand_edits()
        kind = _KINDS.get(shape)
        if kind is None:
            raise InvalidRequest(f"there is no {shape[:32]}; choose box, sphere or cylinder", field="shape")
        if name in self._robot.scene.objects() and name not in self._added:
            raise InvalidRequest(f"there is an object {name[:64]} that somebody else has added", field="name")
        if name.startswith(zone_name("")):
            raise InvalidRequest("that is the name of a zone of the policy", field="name")
        wanted = {"box": 3, "sphere": 1, "cylinder": 2}[shape]
        if len(size) != wanted:
            meaning = {"box": "the edge lengths", "sphere": "the radius", "cylinder": "radius and length"}[shape]
            raise InvalidRequest(f"{len(size)} numbers; the size of a {shape} is {meaning} (m)", field="size")
        fields: dict[str, Any] = {"name": name, "position": tuple(position)}
        if shape == "box":
            fields["size"] = tuple(size)
        else:
            fields["radius"] = size[0]
        if shape == "cylinder":
            fields["length"] = size[1]
        if orientation is not None and shape != "sphere":
            fields["orientation"] = tuple(orientation)
        item: SceneObject = made(kind, kind={"box": "cuboid"}.get(shape, shape), **fields)
        self._robot.scene.add(item, replace=True)
        self._added.add(name)
        return {"added": name}

    def remove_object(self, name: str) -> Json:
        """Remove an object that this agent has added."""
        self._demand_edits()
        if name not in self._added:
            mine = ", ".join(sorted(self._added)) or "nothing"
            raise InvalidRequest(f"only what this agent has added can be removed: {mine}", field="name")
        self._robot.scene.remove(name)
        self._added.discard(name)
        return {"removed": name}

    def plan(self, goal: Any, *, straight: bool = False) -> Json:
        """Plan to joints, a pose, or `home`."""
        planner = self._planner
        if straight and not isinstance(goal, Pose):
            raise InvalidRequest("only a pose is reached on a straight line", field="straight")
        plan = planner.plan_program([Move(Line(goal))]) if straight else planner.plan(goal)
        self._executor.demand(plan)
        self._plans.put(plan)
        return {
            "plan_id": plan.plan_id,
            "seconds": plan.trajectory.time[-1],
            "clearance": plan.clearance,
            "tip": _json(plan.tip),
            "joints": plan.trajectory.position[-1],
            "too_near": [_json(pair) for pair in plan.too_near],
        }

    def home(self) -> tuple[float, ...]:
        """The joints of the home pose."""
        return tuple(self._model.robot.descriptor.home)

    def seen(self, plan_id: str) -> tuple[RobotModel, Plan, list[SceneObject]]:
        """A plan that was made, the robot with its tools, and what is around, for a picture of it."""
        scene = self._robot.scene
        model = self._model.with_tools([*scene.attached().values()])
        return model, self._plans.see(plan_id), list(scene.objects().values())

    def about(self, plan_id: str) -> str:
        """What a plan does, for a person."""
        plan = self._plans.see(plan_id)
        x, y, z = plan.tip.position
        return f"move the tip to {x:.3f}, {y:.3f}, {z:.3f} m in {plan.trajectory.time[-1]:.1f} s (plan {plan_id})"

    def execute(self, plan_id: str) -> Json:
        """Execute a plan, once, and wait for its end."""
        with self._executor.alone():
            plan = self._plans.take(plan_id)
            return _ended(self._executor.execute(plan))

    def pick(
        self, name: str, position: list[float], orientation: list[float] | None, width: float | None = None
    ) -> Json:
        """Pick an object of the scene."""
        if name.startswith(zone_name("")):
            raise InvalidRequest("that is a zone of the policy, no object", field="name")
        with self._executor.alone():
            held = self._grasping.pick(name, pose(position, orientation), width=width)
        return {"held": name, "width": held.width}

    def place(self, position: list[float], orientation: list[float] | None) -> Json:
        """Place what is held."""
        with self._executor.alone():
            state = self._grasping.place(pose(position, orientation))
        return {"width": state.width}

    def gripper(self, width: float) -> Json:
        """Move the gripper."""
        with self._executor.alone():
            state = self._robot.gripper.move(width)
        return {"status": state.status, "width": state.width}

    def speed(self, scale: float) -> Json:
        """Scale the speed of motions, also of one under way; never above what somebody else has set."""
        present = self._robot.speed()
        if present != self._speed:
            self._fastest = present
        if scale > self._fastest:
            raise ExecutionRefused(
                f"somebody has set the speed to {self._fastest:g}; ask them to raise it",
                code="limit_violated",
                field="scale",
            )
        self._speed = self._robot.speed(scale)
        return {"speed_scale": self._speed}

    def stop(self) -> Json:
        """Stop the robot."""
        self._executor.stop()
        return {"mode": self._robot.state().mode}

    def _demand_edits(self) -> None:
        if not self._policy.edit_scene:
            raise ExecutionRefused("the policy does not allow edits of the scene", code="limit_violated")


def pose(position: list[float], orientation: list[float] | None) -> Pose:
    """A pose of the tip, pointing down unless it says otherwise. Raises InvalidRequest."""
    return Pose(tuple(position), DOWN if orientation is None else tuple(orientation))


def _ended(goal: GoalState) -> Json:
    return {"status": goal.status, "seconds": goal.elapsed}


def _json(message: Message) -> Json:
    return message.model_dump(mode="json", exclude_none=True)


def said(error: ZarmError) -> str:
    """An error for an agent: what is wrong and where."""
    problem = error.problem
    where = "" if problem.field is None else f" ({problem.field})"
    return f"{problem.code}: {problem.message}{where}"
