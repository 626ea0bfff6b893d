"""One robot: its planner, executor, servo, scene, grippers, outputs and simulation, and the short form of each of their methods."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Concatenate, ParamSpec, TypeVar, Unpack, cast

from zarm.calls import Calls
from zarm.connection import ANSWER_SECONDS, Connection
from zarm.executor import Executor, OnProgress
from zarm.grasping import Grasping
from zarm.gripper import Gripper
from zarm.motions import Goal
from zarm.outputs import Outputs
from zarm.perception import Perception
from zarm.planner import Planner, PlanOptions, plan_request
from zarm.scene import Scene
from zarm.servo import Servo, Track
from zarm.simulation import Simulation
from zarm.values import Pose
from zarm_contract.messages import GoalState, Health, Nothing

if TYPE_CHECKING:
    from zarm.recording import Recorder

P = ParamSpec("P")
S = TypeVar("S")
T = TypeVar("T")


def _short(part: Callable[[Robot], S], method: Callable[Concatenate[S, P], T]) -> Callable[Concatenate[Robot, P], T]:
    """The short form of a method of one part of a robot."""

    @wraps(method)
    def call(robot: Robot, /, *args: P.args, **kwargs: P.kwargs) -> T:
        return method(part(robot), *args, **kwargs)

    return call


def _planner(robot: Robot) -> Planner:
    return robot.planner


def _executor(robot: Robot) -> Executor:
    return robot.executor


def _grasping(robot: Robot) -> Grasping:
    return robot.grasping


def _servo(robot: Robot) -> Servo:
    return robot.servo


class Robot(Calls):
    """One robot on the bus; `zarm.connect` makes it.

    `planner`, `executor`, `servo`, `scene`, `gripper`, `outputs`, `grasping`, `perception` and `simulation` have the calls of each part; `robot.plan` is short for
    `robot.planner.plan`, and so on. Joint vectors follow the order of `joints` in the robot's descriptor. Poses are those
    of its tip in its base frame. Every method raises a `zarm.Error`: the problem that the service answers, or Unavailable
    if none answers. Thread-safe; Ctrl-C interrupts only the main thread.
    """

    def __init__(self, connection: Connection) -> None:
        super().__init__(connection)
        self.planner = Planner(connection)
        self.executor = Executor(connection)
        self.servo = Servo(connection)
        self.gripper = Gripper(connection)
        self.outputs = Outputs(connection)
        self.grasping = Grasping(connection)
        self.scene = Scene(connection)
        self.perception = Perception(connection)
        self.simulation = Simulation(connection)

    plan = _short(_planner, Planner.plan)
    request_plan = _short(_planner, Planner.request_plan)
    plan_program = _short(_planner, Planner.plan_program)
    request_program = _short(_planner, Planner.request_program)
    cancel_plan = _short(_planner, Planner.cancel_plan)
    settings = _short(_planner, Planner.settings)
    fk = _short(_planner, Planner.fk)
    ik = _short(_planner, Planner.ik)
    request_ik = _short(_planner, Planner.request_ik)
    inverse_dynamics = _short(_planner, Planner.inverse_dynamics)
    check = _short(_planner, Planner.check)
    execute = _short(_executor, Executor.execute)
    start = _short(_executor, Executor.start)
    take_over = _short(_executor, Executor.take_over)
    follow = _short(_executor, Executor.follow)
    goal_states = _short(_executor, Executor.goal_states)
    cancel = _short(_executor, Executor.cancel)
    stop = _short(_executor, Executor.stop)
    pause = _short(_executor, Executor.pause)
    resume = _short(_executor, Executor.resume)
    reset = _short(_executor, Executor.reset)
    speed = _short(_executor, Executor.speed)
    strategy = _short(_executor, Executor.strategy)
    stream = _short(_executor, Executor.stream)
    state = _short(_executor, Executor.state)
    states = _short(_executor, Executor.states)
    joint_state = _short(_executor, Executor.joint_state)
    joint_states = _short(_executor, Executor.joint_states)
    track = cast("Track", _short(_servo, Servo.track))
    jog = _short(_servo, Servo.jog)
    joint_dynamics = _short(_servo, Servo.joint_dynamics)
    pick = _short(_grasping, Grasping.pick)
    place = _short(_grasping, Grasping.place)

    def tip(self, group: str | None = None) -> Pose:
        """The present pose of the tip; with a `group`, that of its tip."""
        return self.fk([self.joint_state().position], group=group)[0]

    def execute_alongside(
        self, goal: Goal, on_progress: OnProgress | None = None, **options: Unpack[PlanOptions]
    ) -> GoalState:
        """Move a `group` to a goal while another goal moves other joints, and wait until all rest. Returns the last state of that goal.

        ```python
        robot.start(robot.plan(one, group="left"))
        robot.execute_alongside(other, group="right")
        ```

        The motion is planned among what is left of the running goal, which stays as it is, and begins as soon as the two stay apart.
        From then on they are one goal, with the id of the running one: pause, cancel, Ctrl-C, speed and guard are for both. If no goal
        runs, or it is as good as done, this is `execute(plan(...))`. Raises what `plan` and `execute` raise; InvalidRequest if the
        running goal moves a joint of the group.
        """
        from zarm.alongside import execute_alongside

        return execute_alongside(self.planner, self.executor, plan_request(goal, **options), on_progress)

    def health(self, service: str, *, timeout: float = ANSWER_SECONDS) -> Health:
        """The health of a service: `planner`, `executor`, ..."""
        return self._ask(self._keys.health(service), Nothing(), timeout=timeout)

    def record(self, file: str | Path, *, scene: bool = False, images: bool = False) -> Recorder:
        """Write what happens to the robot to an MCAP file, which Foxglove and `zarm replay` open, as long as the block lasts.

        ```python
        with robot.record("motion.mcap"):
            robot.execute(plan)
        ```

        With `scene`, the scene, the voxel map and a simulation are in it too, and the page shows them. With `images`, the depth and colour
        images of the cameras are in it, for Foxglove; a replay does not publish them. Raises InvalidRequest for a file that is there already, and
        Unavailable where it cannot be written.
        """
        from zarm.recording import Recorder

        return Recorder(self.connection, Path(file), scene=scene, images=images)
