"""The queries of the executor, one method for each."""

from __future__ import annotations

import logging
import secrets
import threading
from collections.abc import Iterator, Sequence

import numpy as np

from zarm_contract.errors import Busy, InvalidRequest, Unavailable
from zarm_contract.messages import (
    Accepted,
    CancelRequest,
    Continuation,
    ExecuteRequest,
    ExecutorState,
    Nothing,
    PlannedSegment,
    ReplaceTrajectory,
    Speed,
    SpeedRequest,
    Strategies,
    StrategyRequest,
)
from zarm_contract.robot import RobotDescription
from zarm_executor.admission import REST_PATIENCE, Admission
from zarm_executor.checks import continuation, executable, startable
from zarm_executor.goal import Goal, Joined
from zarm_executor.grip_stop import REST_SHARE, GripStop
from zarm_executor.grippers import Grippers
from zarm_executor.machine import Machine
from zarm_executor.monitor import Monitor
from zarm_executor.output_stop import OutputStop
from zarm_executor.outputs import Outputs
from zarm_executor.plans import Plans
from zarm_executor.reporter import Reporter
from zarm_executor.scene import PresentScene
from zarm_executor.strategies.registry import StrategyRegistry
from zarm_runtime import clock
from zarm_runtime.bus import Publisher
from zarm_runtime.state_file import StateFile
from zarm_trajectory.rate_bounds import RateBounds, RateLimits

log = logging.getLogger(__name__)


class Executor:
    """Answers the queries. A ZarmError raised here is the answer, and means that the query has started no motion.

    `arrival` numbers the queries in order of arrival, see `Machine`.
    """

    def __init__(
        self,
        robot: RobotDescription,
        machine: Machine,
        reporter: Reporter,
        admission: Admission,
        plans: Plans,
        present: PresentScene,
        strategies: StrategyRegistry,
        publisher: Publisher[Strategies],
        speeds: Publisher[Speed],
        kept_speed: StateFile[Speed],
        grippers: Grippers,
        outputs: Outputs,
    ) -> None:
        self._grippers, self._outputs = grippers, outputs
        self._robot = robot
        self._machine = machine
        self._reporter = reporter
        self._plans = plans
        self._present = present
        self._strategies = strategies
        self._publisher = publisher
        self._speeds = speeds
        self._kept_speed = kept_speed
        self._admission = admission
        self._describing = threading.Lock()

    def execute(self, request: ExecuteRequest, arrival: int) -> Accepted:
        """Check a motion and start it. One that preempts is fully checked, except for its start, before the current
        goal ends.
        """
        if request.continues is not None:
            return self._continue(request, request.continues)
        with self._admission.turn(arrival, preempt=request.preempt) as turn:
            chosen = self._plans.chosen(request)
            scene = self._present.demand(chosen.name, chosen.scene_revision)
            trajectory = executable(chosen.trajectory, self._robot)
            goal_id = self._named(request.goal_id)
            if request.preempt:
                turn.preempt(goal_id)
                scene = self._present.demand(
                    chosen.name, chosen.scene_revision
                )  # the robot may have taken a while to come to rest
            trajectory = startable(trajectory, self._admission.joint_state(), clock.monotonic(), self._robot)
            monitor = Monitor(trajectory, self._robot.descriptor)
            goal = Goal(
                goal_id,
                chosen.plan_id,
                trajectory,
                monitor,
                scene,
                verified=chosen.scene_revision,
                replan=request.replan and not chosen.along_curve,
                tip=chosen.tip,
                path_constraint=chosen.path_constraint,
                segments=chosen.segments,
                touches=chosen.touches,
                openings=chosen.openings,
                stops=tuple(self._stops(chosen.acts)),
            )
            with self._grippers.as_planned(chosen.name, chosen.openings):
                turn.start(goal)
        RateBounds.of(
            trajectory, RateLimits.of(self._robot.descriptor)
        ).prepare()  # so that no tick has to compute them
        return Accepted(goal_id=goal_id)

    def _continue(self, request: ExecuteRequest, where: Continuation) -> Accepted:
        """Let a plan take over from a running goal. Raises what the checks of a motion and `Machine.replace` raise."""
        chosen = self._plans.chosen(request)
        if chosen.scene_revision is None or chosen.touches or chosen.acts:
            raise InvalidRequest("only a motion that touches nothing can take over from a goal", field="continues")
        self._present.demand(chosen.name, chosen.scene_revision)
        trajectory = continuation(chosen.trajectory, self._robot, np.zeros(len(self._robot.descriptor.joints)))
        with self._grippers.as_planned(chosen.name, chosen.openings):
            goal = self._machine.replace(
                where.goal_id,
                where.number,
                trajectory,
                chosen.scene_revision,
                where.at,
                chosen.openings,
                joined=Joined(chosen.path_constraint),
            )
        return self._shown(goal)

    def _shown(self, goal: Goal) -> Accepted:
        """Publish what is followed for a goal from now on."""
        self._reporter.show(goal)
        self._reporter.publish()
        return Accepted(goal_id=goal.goal_id)

    def _stops(self, acts: Sequence[PlannedSegment]) -> Iterator[GripStop | OutputStop]:
        """Where a goal rests until a gripper has moved or an output is switched. Raises InvalidRequest for one that is not there."""
        for segment in acts:
            until = segment.begin + REST_SHARE * (segment.end - segment.begin)
            if segment.grip is not None:
                yield self._grippers.stop_at(until, segment.grip)
            if segment.output is not None:
                yield OutputStop(until, self._outputs.named(segment.output.output), segment.output.on)

    def replace(self, request: ReplaceTrajectory) -> Accepted:
        """Continue a goal along another trajectory. Raises what the checks of a motion and `Machine.replace` raise."""
        revision = request.scene_revision
        if self._machine.scene != revision:
            self._present.demand("the trajectory", revision)
        start: float | Monitor
        if request.at is None:
            trajectory = executable(request.trajectory, self._robot)
            trajectory = startable(trajectory, self._admission.joint_state(), clock.monotonic(), self._robot)
            start = Monitor(trajectory, self._robot.descriptor)
        else:
            trajectory = continuation(request.trajectory, self._robot, np.zeros(len(self._robot.descriptor.joints)))
            start = request.at
        goal = self._machine.replace(
            request.goal_id, request.number, trajectory, revision, start, request.openings, request.until
        )
        return self._shown(goal)

    def _named(self, goal_id: str | None) -> str:
        running = self._reporter.publish().goal_id  # also records a goal that has just ended
        if goal_id is not None and (goal_id == running or self._reporter.knows(goal_id)):
            raise InvalidRequest(
                f"the goal_id {goal_id} was used before; give every goal a new goal_id", field="goal_id"
            )
        return goal_id or f"goal-{secrets.token_hex(4)}"

    def check_idle(self) -> None:
        """Raises Busy unless the robot is at rest and nothing is wrong."""
        mode = self._machine.state().mode
        if mode != "idle":
            raise Busy(f"the executor is in the mode {mode}; let the goal end, or reset the fault, and try again")
        self._grippers.check_idle()

    def cancel(self, request: CancelRequest, arrival: int) -> ExecutorState:
        """Cancel the given goal, or the running one."""
        self._machine.cancel(request.goal_id, "the goal was cancelled by a client", arrival)
        return self._reporter.publish()

    def stop(self, _: Nothing, arrival: int) -> ExecutorState:
        """Bring the robot to rest."""
        self._machine.stop("the robot was stopped by a client", arrival)
        self._grippers.stop(arrival)
        return self._reporter.publish()

    def pause(self, _: Nothing, arrival: int) -> ExecutorState:
        """Hold the running goal."""
        self._machine.pause(arrival)
        return self._reporter.publish()

    def resume(self, _: Nothing, arrival: int) -> ExecutorState:
        """Resume the held goal. Raises what `Admission.demand_presence` and `Machine.resume` raise."""
        self._admission.demand_presence()
        scene, state = self._present.look(), self._machine.state()
        if state.guarded and state.goal_id is not None:
            self._machine.wait_for_authority(state.goal_id, scene)
        self._machine.resume(arrival, scene)
        return self._reporter.publish()

    def reset(self, _: Nothing, arrival: int) -> ExecutorState:
        """Leave `fault`."""
        self._machine.reset(arrival)
        return self._reporter.publish()

    def speed(self, request: SpeedRequest) -> Speed:
        """Read or change the robot's share of the planned speed, also while it moves."""
        if request.speed_scale is not None:
            self._machine.set_speed(request.speed_scale)
            self._reporter.publish()
            self.publish_speed()
            self._keep_speed()
        return self._speed()

    def _keep_speed(self) -> None:
        try:
            self._kept_speed.save(self._speed())
        except Unavailable as error:  # the robot slows down at once, even if the file cannot be written
            log.warning("the speed is not saved and will be lost on restart reason=%s", error)

    def publish_speed(self) -> None:
        """Publish the robot's share of the planned speed."""
        self._speeds.put(self._speed())

    def _speed(self) -> Speed:
        return Speed(speed_scale=self._machine.state().speed_scale)

    def strategy(self, request: StrategyRequest, arrival: int) -> Strategies:
        """Read which strategy is active, or switch to another."""
        name = request.strategy
        if name is None or name == self._machine.state().strategy:
            return self._describe_strategies()
        try:
            self._machine.switch(self._strategies.find(name), REST_PATIENCE, arrival)
            self._grippers.switch(name)
            self._outputs.switch(name)
        finally:
            self._reporter.publish()
        return self.publish_strategies()

    def publish_strategies(self) -> Strategies:
        """Publish which strategy is active; after several switches, the last one is published last."""
        with self._describing:
            strategies = self._describe_strategies()
            self._publisher.put(strategies)
        return strategies

    def _describe_strategies(self) -> Strategies:
        return Strategies(
            active=self._machine.state().strategy,
            strategies=self._strategies.describe(),
        )
