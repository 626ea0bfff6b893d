"""One robot: plans, motions, kinematics and its live state."""

from __future__ import annotations

import secrets
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict, TypeVar, Unpack

from pydantic import ValidationError

from zarm.connection import ANSWER_SECONDS, Connection
from zarm.scene import Scene
from zarm.values import Goal, Pose, goal_of, invalid, numbers, pose_of, rows
from zarm_contract.errors import ExecutionRefused, Unavailable, ZarmError, from_problem
from zarm_contract.keys import Keys
from zarm_contract.messages import (
    Accepted,
    CancelledPlan,
    CancelPlan,
    CancelRequest,
    CheckRequest,
    CheckResult,
    CheckResults,
    ExecuteRequest,
    ExecutorState,
    FkPoses,
    FkRequest,
    GoalState,
    Health,
    IkRequest,
    IkSolutions,
    JointState,
    Message,
    PathConstraint,
    Plan,
    PlannerKind,
    PlannerSettings,
    PlanRequest,
    ServoStart,
    SettingsChange,
    Speed,
    SpeedRequest,
    StartState,
    Strategies,
    StrategyRequest,
    Trajectory,
)
from zarm_contract.messages import Pose as PoseMessage

if TYPE_CHECKING:
    from zarm.recording import Recorder
    from zarm.servoing import Jogging, Tracking
    from zarm.streaming import Stream
    from zarm.values import Numbers, Rows

LONGEST_PLANNING = 60.0
"""s, what the planner allows at most."""
REST_SECONDS = 30.0
"""Longest wait for a robot that is brought to rest, and for what brings it to rest first."""
_MEASURED_SECONDS = 2.0

M = TypeVar("M", bound=Message)
S = TypeVar("S", "Jogging", "Tracking")
OnProgress = Callable[[GoalState], object]
"""Is told each state of a goal that differs from the one before."""


class Settings(TypedDict, total=False):
    """What can be set for all plans; `Robot.plan` says what each is."""

    planner: PlannerKind
    timeout: float
    max_attempts: int
    optimize_s: float
    velocity_scale: float
    acceleration_scale: float
    margin: float


class Robot:
    """One robot on the bus; `zarm.connect` makes it.

    Joint vectors follow the order of `joints` in the robot's descriptor. Poses are of its tip in its base frame. Every method
    raises a `zarm.Error`: what the service answers, or Unavailable where none answers. Safe from any thread; Ctrl-C interrupts
    only the main one.
    """

    def __init__(self, connection: Connection) -> None:
        self.connection = connection
        self.scene = Scene(connection)

    @property
    def name(self) -> str:
        """Its name on the bus."""
        return self.connection.keys.robot

    # -- planning --

    def plan(
        self,
        goal: Goal,
        *,
        start: Numbers | StartState | None = None,
        path_constraint: PathConstraint | None = None,
        planner: PlannerKind | None = None,
        timeout: float | None = None,
        max_attempts: int | None = None,
        optimize_s: float | None = None,
        velocity_scale: float | None = None,
        acceleration_scale: float | None = None,
        margin: float | None = None,
        seed: int = 0,
    ) -> Plan:
        """A verified motion to a `zarm.Pose`, to joint positions (rad), to `zarm.AnyOf` several poses, or through
        `zarm.Waypoints`. Nothing moves.

        `start` are joint positions (rad), left out: the measured ones; or a `zarm.StartState` in motion, with which the plan is
        continuous in position, velocity and acceleration. `timeout` (s) is the deadline of the planning, and
        `max_attempts` the number of searches after which it gives up earlier. For `optimize_s` s after the first motion is found
        the planner looks for faster ones. The scales (above 0, up to 1) are fractions of the joint limits; `margin` (m) is kept
        to objects on the way. What is left out comes from `settings`. The same request, seed, scene and `optimize_s` 0 give
        the same motion.

        Ctrl-C ends the planning too. Raises PlanningFailed, DeadlineExceeded, InvalidRequest.
        """
        return self.request_plan(
            _made(
                PlanRequest,
                goal=goal_of(goal),
                start=None if isinstance(start, StartState) else _joints(start, "start"),
                start_state=start if isinstance(start, StartState) else None,
                path_constraint=path_constraint,
                planner=planner,
                timeout=timeout,
                max_attempts=max_attempts,
                optimize_s=optimize_s,
                velocity_scale=velocity_scale,
                acceleration_scale=acceleration_scale,
                margin=margin,
                seed=seed,
            )
        )

    def request_plan(self, request: PlanRequest) -> Plan:
        """`plan`, asked by a message; its `request_id`, if it has none, is chosen here."""
        named = request.model_copy(update={"request_id": request.request_id or f"plan-{secrets.token_hex(8)}"})
        timeout = (request.timeout or LONGEST_PLANNING) + ANSWER_SECONDS
        try:
            return self._ask(self._keys.plan, Plan, named, timeout=timeout)
        except KeyboardInterrupt:
            with suppress(Unavailable):
                self.cancel_plan(named.request_id or "")
            raise

    def cancel_plan(self, request_id: str, *, timeout: float = ANSWER_SECONDS) -> bool:
        """End a planning by the `request_id` of its request, also one that is yet to come; whether it was running."""
        request = CancelPlan(request_id=request_id)
        return self._ask(self._keys.plan_cancel, CancelledPlan, request, timeout=timeout).was_running

    def settings(self, /, **changes: Unpack[Settings]) -> PlannerSettings:
        """What plans are made with where a request leaves it out, after these changes: `settings(margin=0.01)`."""
        if not changes:
            return self.connection.read(self._keys.settings, PlannerSettings)
        return self._ask(self._keys.settings, PlannerSettings, _made(SettingsChange, **changes))

    # -- kinematics --

    def fk(self, joints: Rows, *, timeout: float = ANSWER_SECONDS) -> list[Pose]:
        """The tip's pose at each row of joint positions (rad), up to 1000 of them."""
        request = _made(FkRequest, joints=rows(joints, "joints"))
        poses = self._ask(self._keys.fk, FkPoses, request, timeout=timeout).poses
        return [pose_of(pose) for pose in poses]

    def ik(
        self,
        pose: PoseMessage,
        *,
        near: Numbers | None = None,
        max_solutions: int = 8,
        collision_free: bool = True,
        seed: int = 0,
    ) -> list[tuple[float, ...]]:
        """Joint positions (rad) that bring the tip to a pose, those nearest to `near` (default: the measured) first.

        Empty where there is none.
        """
        request = _made(
            IkRequest,
            poses=(PoseMessage(position=pose.position, orientation=pose.orientation),),
            near=_joints(near, "near"),
            max_solutions=max_solutions,
            collision_free=collision_free,
            seed=seed,
        )
        return list(self.request_ik(request, timeout=ANSWER_SECONDS).solutions[0])

    def request_ik(self, request: IkRequest, *, timeout: float = LONGEST_PLANNING + ANSWER_SECONDS) -> IkSolutions:
        """Inverse kinematics of up to 1000 poses, asked by a message."""
        return self._ask(self._keys.ik, IkSolutions, request, timeout=timeout)

    def check(
        self,
        joints: Rows | None = None,
        *,
        spheres: bool = False,
        points: bool = False,
        timeout: float = ANSWER_SECONDS,
    ) -> Sequence[CheckResult]:
        """How close the robot comes to the scene and to itself (m) at each row of joint positions (rad), up to 1000 of them.

        Left out, at the measured ones. With `spheres` the distance of each collision sphere is told as well, with `points` the
        two nearest points.
        """
        where = None if joints is None else rows(joints, "joints")
        request = _made(CheckRequest, joints=where, spheres=spheres, points=points)
        return self._ask(self._keys.check, CheckResults, request, timeout=timeout).results

    # -- motion --

    def execute(
        self,
        what: Plan | Trajectory | ExecuteRequest | str | None = None,
        *,
        preempt: bool = False,
        replan: bool = False,
        on_progress: OnProgress | None = None,
    ) -> GoalState:
        """Move the robot along a plan, and wait until it rests at the end; the goal's last state.

        `what` is a plan, its id, a trajectory (which nobody has checked against the scene), or left out: the last plan that
        was made. A goal that runs makes this one Busy, unless `preempt`: then that goal is cancelled first. With
        `replan` the servo plans anew, in motion, when something is put in the way. `on_progress` is told the goal's states,
        some ten a second; its exception stops the robot.

        Ctrl-C cancels the goal, waits until the robot rests, and then raises KeyboardInterrupt; a second one does not wait.
        Raises ExecutionRefused before and ExecutionFailed during the motion, Cancelled where another client ended it, and
        Unavailable where the executor is gone, and what the robot does is not known.
        """
        with self._new_goal() as goal_id:
            self._send(what, goal_id, preempt, replan)
            last = self._followed(goal_id, on_progress)
        if last.problem is not None:
            raise from_problem(last.problem)
        return last

    def start(
        self,
        what: Plan | Trajectory | ExecuteRequest | str | None = None,
        *,
        preempt: bool = False,
        replan: bool = False,
        timeout: float = REST_SECONDS,
    ) -> str:
        """`execute` that does not wait: the id of the goal, for `follow` and `cancel`. The motion goes on without this program.

        The executor takes or refuses it within `timeout` s, else it is withdrawn.
        """
        with self._new_goal() as goal_id:
            self._send(what, goal_id, preempt, replan, timeout)
        return goal_id

    def follow(
        self,
        goal_id: str,
        on_progress: OnProgress | None = None,
        *,
        timeout: float | None = None,
    ) -> GoalState:
        """Wait for the end of a goal, whoever started it; its last state, which tells whether it succeeded.

        Ctrl-C ends the wait and not the goal. Raises Unavailable where nothing is heard of it for 10 s, or where it has not
        ended after `timeout` s.
        """
        for state in self.goal_states(goal_id, timeout=timeout):
            if on_progress is not None:
                on_progress(state)
        return state

    def goal_states(self, goal_id: str, *, timeout: float | None = None) -> Generator[GoalState]:
        """The states of a goal up to its last one, each different from the one before; raises as `follow` does."""
        before: GoalState | None = None
        for state in self.connection.goals.states(goal_id, self.connection.interrupts, timeout=timeout):
            if state != before:
                before = state
                yield state

    def cancel(self, goal_id: str | None = None, *, timeout: float = ANSWER_SECONDS) -> ExecutorState:
        """Cancel a goal, or left out the one that runs; the robot decelerates to rest. A finished goal is no error."""
        request = _made(CancelRequest, goal_id=goal_id)
        return self._ask(self._keys.cancel, ExecutorState, request, timeout=timeout)

    def stop(self) -> ExecutorState:
        """Stop the robot now, whoever moves it; it decelerates to rest."""
        return self._ask(self._keys.stop, ExecutorState)

    def pause(self) -> ExecutorState:
        """Hold the motion; `resume` goes on with it."""
        return self._ask(self._keys.pause, ExecutorState)

    def resume(self) -> ExecutorState:
        """Go on with a motion that was paused."""
        return self._ask(self._keys.resume, ExecutorState)

    def reset(self) -> ExecutorState:
        """Leave the fault state, once its reason is mended."""
        return self._ask(self._keys.reset, ExecutorState)

    def speed(self, scale: float | None = None) -> float:
        """The share (0.05 to 1) of the planned speed at which the robot moves, after it was changed to `scale`, if given."""
        if scale is None:
            return self.connection.read(self._keys.speed, Speed).speed_scale
        return self._ask(self._keys.speed, Speed, _made(SpeedRequest, speed_scale=scale)).speed_scale

    def strategy(self, name: str | None = None) -> Strategies:
        """The control strategies of this robot and which one is active, after a switch to `name`, if given."""
        if name is None:
            return self.connection.read(self._keys.strategy, Strategies)
        return self._ask(self._keys.strategy, Strategies, _made(StrategyRequest, strategy=name), timeout=REST_SECONDS)

    @contextmanager
    def stream(self, *, deadline: float = 0.2) -> Iterator[Stream]:
        """A stream of short trajectories, each in place of what is left of the one before: closed-loop control.

        ```python
        with robot.stream() as stream:
            while stream.running and not done:
                stream.send(trajectory_from(stream.time))
        ```

        The next one must be sent within `deadline` s (at most 1), else the robot brakes and DeadlineExceeded is raised. Leaving
        the block waits until the robot rests: at the end of a trajectory that was sent as the `last`, else it brakes at once.
        """
        from zarm.streaming import Stream

        stream = Stream(self.connection, deadline)
        try:
            yield stream
        except BaseException:
            self._rest(stream.goal_id)
            raise
        if stream.open:
            self._rest(stream.goal_id)
        elif (end := stream.end()) is not None and end.problem is not None:
            raise from_problem(end.problem)

    @contextmanager
    def track(
        self,
        *,
        margin: float = 0.01,
        velocity_scale: float = 1.0,
        acceleration_scale: float = 1.0,
        take_over: bool = False,
    ) -> Iterator[Tracking]:
        """The robot follows a pose or joint positions that change all the time, and stays away from everything.

        ```python
        with robot.track() as tracking:
            while looking:
                tracking.to(seen_pose())
        ```

        `margin` (m) is kept to the scene and between the robot's own links; the scales are shares of the limits of velocity and
        acceleration. Where another session is open this is Busy, unless it is to `take_over`. Leaving the block brings the robot
        to rest. Raises Unavailable without a servo, or where it does not know the scene.
        """
        from zarm.servoing import Tracking

        with self._session(Tracking, margin, velocity_scale, acceleration_scale, take_over) as tracking:
            yield tracking

    @contextmanager
    def jog(
        self,
        *,
        margin: float = 0.01,
        velocity_scale: float = 1.0,
        acceleration_scale: float = 1.0,
        take_over: bool = False,
    ) -> Iterator[Jogging]:
        """The robot moves by a twist of its tip or by joint speeds, as long as it is told to: see `track`.

        ```python
        with robot.jog() as jogging:
            while pressed():
                jogging.twist(linear=(0, 0, 0.05))
        ```
        """
        from zarm.servoing import Jogging

        with self._session(Jogging, margin, velocity_scale, acceleration_scale, take_over) as jogging:
            yield jogging

    # -- looking --

    def state(self) -> ExecutorState:
        """What the executor does now."""
        return self.connection.read(self._keys.executor_state, ExecutorState)

    def states(self) -> Generator[ExecutorState]:
        """What the executor does now, and each change from then on, without end."""
        return self.connection.latched(self._keys.executor_state, ExecutorState)

    def joint_state(self) -> JointState:
        """The joints as measured next: rad and rad/s. Raises ExecutionRefused (`no_joint_state`) where none comes."""
        state = self.connection.next(self._keys.joint_states, JointState, _MEASURED_SECONDS)
        if state is None:
            raise ExecutionRefused(
                f"no joint state of {self.name} came within {_MEASURED_SECONDS:g} s; `zarm status` shows whether its executor "
                "runs and with which strategy",
                code="no_joint_state",
            )
        return state

    def joint_states(self) -> Generator[JointState]:
        """The joints as they are measured (rad, rad/s), without end; the newest, where the loop is slower than they come."""
        return self.connection.published(self._keys.joint_states, JointState)

    def tip(self) -> Pose:
        """Where the tip is now."""
        return self.fk([self.joint_state().position])[0]

    def health(self, service: str, *, timeout: float = ANSWER_SECONDS) -> Health:
        """How a service is: `planner`, `executor`, ..."""
        return self._ask(self._keys.health(service), Health, timeout=timeout)

    def record(self, file: str | Path) -> Recorder:
        """Write what happens to the robot to an MCAP file, which Foxglove and `zarm replay` open, as long as the block lasts.

        ```python
        with robot.record("motion.mcap"):
            robot.execute(plan)
        ```

        Raises InvalidRequest for a file that is there already, and Unavailable where it cannot be written.
        """
        from zarm.recording import Recorder

        return Recorder(self.connection, Path(file))

    # -- inside --

    @property
    def _keys(self) -> Keys:
        return self.connection.keys

    def _ask(self, key: str, reply: type[M], request: Message | None = None, *, timeout: float = ANSWER_SECONDS) -> M:
        return self.connection.ask(key, reply, request, timeout=timeout)

    @contextmanager
    def _session(
        self,
        kind: Callable[[Connection, ServoStart], S],
        margin: float,
        velocity_scale: float,
        acceleration_scale: float,
        take_over: bool,
    ) -> Iterator[S]:
        request = _made(
            ServoStart,
            margin=margin,
            velocity_scale=velocity_scale,
            acceleration_scale=acceleration_scale,
            take_over=take_over,
        )
        session = kind(self.connection, request)
        try:
            yield session
        except BaseException:
            with self._until_left(), suppress(ZarmError):
                session.end()
            raise
        session.end()

    @contextmanager
    def _new_goal(self) -> Iterator[str]:
        """The id of a new goal; an interruption in the block brings the robot to rest, and says how it stands."""
        goal_id = f"goal-{secrets.token_hex(8)}"
        try:
            yield goal_id
        except KeyboardInterrupt as interruption:
            if interruption.args:  # it comes from a rest that somebody would not wait for
                raise
            raise KeyboardInterrupt(self._rest(goal_id)) from None

    def _send(
        self,
        what: Plan | Trajectory | ExecuteRequest | str | None,
        goal_id: str,
        preempt: bool,
        replan: bool,
        timeout: float = REST_SECONDS,
    ) -> None:
        """Ask for a goal; one that was asked for without an answer is withdrawn."""
        request = _execution(what)
        flags = {"preempt": preempt or request.preempt, "replan": replan or request.replan}
        request = request.model_copy(update={"goal_id": goal_id, **flags})
        self.connection.interrupts.attend(self.connection.goals.listen)
        try:
            with self.connection.interrupts.insist(f"the executor of {self.name} to take the goal or refuse it"):
                self._ask(self._keys.execute, Accepted, request, timeout=timeout)
        except Unavailable:  # the executor may have got the request, and start yet
            with self._until_left(), suppress(Unavailable):
                self.cancel(goal_id)
            raise

    def _followed(self, goal_id: str, on_progress: OnProgress | None) -> GoalState:
        for state in self.goal_states(goal_id):
            if on_progress is not None:
                try:
                    on_progress(state)
                except Exception:
                    self._rest(goal_id)
                    raise
        return state

    def _rest(self, goal_id: str) -> str:
        """Cancel a goal of this client and wait until the robot rests; how it stands there, in words."""
        with self._until_left():
            told: ExecutorState | None = None
            with suppress(Unavailable):
                told = self.cancel(goal_id)
            known = self.connection.goals.known(goal_id)
            if told is None and known is None:
                return self._unknown()
            if told is not None and told.goal_id != goal_id and known is None:
                return "cancelled: the goal is withdrawn, and the robot has not moved for it"
            last = self.follow(goal_id, timeout=REST_SECONDS)
            return f"{last.status}: the robot stands still at {last.progress:.0%} of the motion"

    @contextmanager
    def _until_left(self) -> Iterator[None]:
        """A block that insists on rest; who leaves it before is told what that means."""
        try:
            with self.connection.interrupts.insist(f"the executor of {self.name} to bring the robot to rest"):
                yield
        except KeyboardInterrupt:
            raise KeyboardInterrupt(self._unknown()) from None

    def _unknown(self) -> str:
        return (
            f"interrupted: the executor of {self.name} has not answered, and the state of the robot is unknown: make sure that "
            "it stands still, then see `zarm status`"
        )


def _execution(what: Plan | Trajectory | ExecuteRequest | str | None) -> ExecuteRequest:
    match what:
        case ExecuteRequest():
            return what
        case Plan():
            return ExecuteRequest(plan_id=what.plan_id)
        case Trajectory():
            return ExecuteRequest(trajectory=what)
        case _:
            return _made(ExecuteRequest, plan_id=what)


def _joints(values: Numbers | None, field: str) -> tuple[float, ...] | None:
    return None if values is None else numbers(values, field)


def _made(model: type[M], **fields: object) -> M:
    """A request. Raises InvalidRequest that names the field at fault."""
    try:
        return model(**fields)
    except ValidationError as error:
        raise invalid(model.__name__, error) from None
