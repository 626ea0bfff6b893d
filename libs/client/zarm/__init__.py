"""zarm from Python: plan motions of a robot arm around its scene, and carry them out.

```python
import zarm

with zarm.connect() as robot:
    robot.scene.add(zarm.Cuboid("table", size=(1, 1, 0.1), position=(0.5, 0, -0.1)))
    plan = robot.plan(zarm.Pose((0.5, 0.2, 0.4), (0, 1, 0, 0)))
    robot.execute(plan, on_progress=print)
```

Lengths are m, angles rad, times s; quaternions are (x, y, z, w); poses are of the robot's tip in its base frame; joint vectors
follow the order of the robot's descriptor. Wherever joints or points are asked for, a numpy array will do. What goes wrong
is a `zarm.Error`. `zarm.aio` is the same for asyncio.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import TYPE_CHECKING

from zarm.camera import Camera
from zarm.connection import CONNECT_SECONDS, connected, robots
from zarm.gripper import Gripper, GripperOptions
from zarm.motions import (
    AnyOf,
    Arc,
    Attach,
    Detach,
    Goal,
    Grip,
    Line,
    Move,
    Offset,
    Path,
    PathPoint,
    PoseGoal,
    SetOutput,
    SpeedChange,
    TipFrame,
    Wait,
    Waypoints,
)
from zarm.objects import Capsule, Cuboid, Cylinder, Mesh, PointCloud, Sphere, Voxels
from zarm.outputs import Outputs
from zarm.planner import PlanOptions
from zarm.record_story import Story
from zarm.replaying import replay, story
from zarm.robot import Robot
from zarm.scene import Scene
from zarm.servoing import ChunkTracking, Jogging, Tracking
from zarm.streaming import Stream
from zarm.values import Axis, PathConstraint, Pose, StartState, Trajectory
from zarm_contract.errors import (
    Busy,
    Cancelled,
    DeadlineExceeded,
    ExecutionFailed,
    ExecutionRefused,
    InternalError,
    InvalidRequest,
    PlanningFailed,
    Problem,
    Unavailable,
)
from zarm_contract.errors import ZarmError as Error
from zarm_contract.messages import (
    CheckResult,
    ExecutorState,
    GoalState,
    GripperState,
    Health,
    JointState,
    Plan,
    PlannerSettings,
    SceneObject,
    ServoSession,
    Strategies,
)
from zarm_contract.roles import Role

if TYPE_CHECKING:
    from zarm import aio

__all__ = [
    "AnyOf",
    "Arc",
    "Attach",
    "Axis",
    "Busy",
    "Camera",
    "Cancelled",
    "Capsule",
    "CheckResult",
    "ChunkTracking",
    "Cuboid",
    "Cylinder",
    "DeadlineExceeded",
    "Detach",
    "Error",
    "ExecutionFailed",
    "ExecutionRefused",
    "ExecutorState",
    "Goal",
    "GoalState",
    "Grip",
    "Gripper",
    "GripperOptions",
    "GripperState",
    "Health",
    "InternalError",
    "InvalidRequest",
    "Jogging",
    "JointState",
    "Line",
    "Mesh",
    "Move",
    "Offset",
    "Outputs",
    "Path",
    "PathConstraint",
    "PathPoint",
    "Plan",
    "PlanOptions",
    "PlannerSettings",
    "PlanningFailed",
    "PointCloud",
    "Pose",
    "PoseGoal",
    "Problem",
    "Robot",
    "Role",
    "Scene",
    "SceneObject",
    "ServoSession",
    "SetOutput",
    "SpeedChange",
    "Sphere",
    "StartState",
    "Story",
    "Strategies",
    "Stream",
    "TipFrame",
    "Tracking",
    "Trajectory",
    "Unavailable",
    "Voxels",
    "Wait",
    "Waypoints",
    "aio",
    "connect",
    "replay",
    "robots",
    "story",
]


@contextmanager
def connect(
    endpoint: str | None = None,
    name: str | None = None,
    *,
    role: Role | None = None,
    timeout: float = CONNECT_SECONDS,
) -> Iterator[Robot]:
    """A robot on the bus, as long as the block lasts.

    `endpoint` is the router's (default: $ZARM_CONNECT, else that of `zarm up` on this machine). `name` is the robot's (default:
    $ZARM_NAME, else the only robot). The client waits `timeout` s for the router. With ZARM_SECURITY=on it has the rights of
    `role` (default: $ZARM_ROLE, else operator), with the certificate in $ZARM_CERTS.

    Raises Unavailable without a router or a robot, InvalidRequest if there are several or the name is invalid.
    """
    with connected(endpoint, name, role=role, timeout=timeout) as connection:
        yield Robot(connection)


def __getattr__(name: str) -> ModuleType:
    """`zarm.aio`, loaded on demand: asyncio takes longer to load than the rest of the client."""
    if name == "aio":
        from importlib import import_module

        return import_module("zarm.aio")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
