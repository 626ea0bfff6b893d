"""Actions of move_group: move_action, execute_trajectory and sequence_move_group."""

from __future__ import annotations

import hashlib
import threading
import time
from collections import OrderedDict
from collections.abc import Sequence
from typing import Any

import numpy as np
from moveit_msgs.action import ExecuteTrajectory, MoveGroup, MoveGroupSequence
from moveit_msgs.msg import MoveItErrorCodes as Val
from std_msgs.msg import String

from zarm.connection import ANSWER_SECONDS
from zarm_contract.errors import Cancelled, ZarmError, from_problem
from zarm_contract.messages import ExecuteRequest, Plan
from zarm_ros_bridge.action_servers import Action, ActionServers
from zarm_ros_bridge.convert.joint_trajectories import trajectory_of
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.frames import Frames
from zarm_ros_bridge.goals import Run
from zarm_ros_bridge.moveit.error_codes import Refusal, error_code
from zarm_ros_bridge.moveit.executed import executed_trajectory, measured
from zarm_ros_bridge.moveit.gripper_groups import GripperGroups
from zarm_ros_bridge.moveit.requests import MotionPlanRequests
from zarm_ros_bridge.moveit.scene import PlanningScenes
from zarm_ros_bridge.moveit.states import robot_trajectory, trajectory_start
from zarm_ros_bridge.ros import Ros
from zarm_ros_bridge.turns import Turns

_PLANS_KEPT = 100
"""Plans whose trajectory is known again when a client sends it back."""


class PlansByTrajectory:
    """The latest plans, found by what a client holds of them. Thread-safe."""

    def __init__(self) -> None:
        self._turn = threading.Lock()
        self._plans: OrderedDict[str, str] = OrderedDict()

    def remember(self, plan: Plan) -> Plan:
        """From now on this plan is known by its trajectory; returns it."""
        trajectory = plan.trajectory
        with self._turn:
            self._plans[_digest(trajectory.joint_names, trajectory.position, trajectory.time)] = plan.plan_id
            while len(self._plans) > _PLANS_KEPT:
                self._plans.popitem(last=False)
        return plan

    def found(self, joint_trajectory: Any) -> str | None:
        """The id of the plan with exactly this trajectory, None if a client made or changed it."""
        times = [point.time_from_start.sec + point.time_from_start.nanosec * 1e-9 for point in joint_trajectory.points]
        rows = [point.positions for point in joint_trajectory.points]
        if len({len(row) for row in rows}) != 1:
            return None
        with self._turn:
            return self._plans.get(_digest(joint_trajectory.joint_names, rows, times))


class Actions:
    """Serves the actions, and `trajectory_execution_event`."""

    def __init__(
        self,
        ros: Ros,
        engine: Engine,
        frames: Frames,
        requests: MotionPlanRequests,
        scenes: PlanningScenes,
        servers: ActionServers,
        turns: Turns,
    ) -> None:
        self._engine = engine
        self._frames = frames
        self._requests = requests
        self._scenes = scenes
        self._grippers = GripperGroups(engine)
        self._turns = turns
        self._log = ros.node.get_logger()
        self.plans = PlansByTrajectory()
        servers.serve(
            ros, Action(MoveGroup, "move_action", "move_action", self._move, self._not_moved, moves=_executes)
        )
        servers.serve(
            ros,
            Action(ExecuteTrajectory, "execute_trajectory", "move_group_execute", self._execute, self._not_executed),
        )
        servers.serve(
            ros,
            Action(
                MoveGroupSequence,
                "sequence_move_group",
                "sequence_move_group",
                self._move_in_sequence,
                self._not_moved_in_sequence,
                moves=_executes,
            ),
        )
        ros.listen(String, ros.node.resolve_topic_name("trajectory_execution_event"), self._event, 10)

    def _move(self, run: Run) -> MoveGroup.Result:
        result = MoveGroup.Result(error_code=error_code(None))
        if run.taken_up:
            self._follow(run, run.name, MoveGroup.Feedback)
            return result
        goal = run.handle.request
        self._scenes.check_diff(goal.planning_options.planning_scene_diff)
        run.handle.publish_feedback(MoveGroup.Feedback(state="PLANNING"))
        if goal.request.group_name in self._grippers:
            motion = self._grippers.plan(goal.request)
            result.trajectory_start, result.planned_trajectory = motion.start, motion.trajectory
            if not goal.planning_options.plan_only:
                self._grip(motion.trajectory.joint_trajectory, run)
                result.executed_trajectory = motion.trajectory
            return result
        began = time.monotonic()
        plan = self.plans.remember(self._requests.plan(goal.request, run.plan))
        result.planning_time = time.monotonic() - began
        result.trajectory_start = trajectory_start(plan)
        result.planned_trajectory = robot_trajectory(plan, self._frames.links.base)
        if not goal.planning_options.plan_only:
            with measured(self._engine) as states:
                self._started(run, ExecuteRequest(plan_id=plan.plan_id), replan=goal.planning_options.replan)
                self._follow(run, run.name, MoveGroup.Feedback)
            result.executed_trajectory = executed_trajectory(states, self._frames.links.base)
        run.handle.publish_feedback(MoveGroup.Feedback(state="IDLE"))
        return result

    def _move_in_sequence(self, run: Run) -> MoveGroupSequence.Result:
        result = MoveGroupSequence.Result()
        response = result.response
        response.error_code = error_code(None)
        if run.taken_up:
            self._follow(run, run.name, MoveGroupSequence.Feedback)
            return result
        goal = run.handle.request
        self._scenes.check_diff(goal.planning_options.planning_scene_diff)
        run.handle.publish_feedback(MoveGroupSequence.Feedback(state="PLANNING"))
        began = time.monotonic()
        plan = self.plans.remember(self._requests.plan_sequence(goal.request.items, run.plan))
        response.planning_time = time.monotonic() - began
        response.sequence_start = trajectory_start(plan)
        response.planned_trajectories = [robot_trajectory(plan, self._frames.links.base)]
        if not goal.planning_options.plan_only:
            self._started(run, ExecuteRequest(plan_id=plan.plan_id))
            self._follow(run, run.name, MoveGroupSequence.Feedback)
        run.handle.publish_feedback(MoveGroupSequence.Feedback(state="IDLE"))
        return result

    def _execute(self, run: Run) -> ExecuteTrajectory.Result:
        if not run.taken_up:
            trajectory = run.handle.request.trajectory
            if trajectory.multi_dof_joint_trajectory.points:
                raise Refusal(
                    Val.INVALID_MOTION_PLAN,
                    "the robot has no joints of several degrees of freedom; leave them out",
                    "trajectory.multi_dof_joint_trajectory",
                )
            if self._grip(trajectory.joint_trajectory, run):
                return ExecuteTrajectory.Result(error_code=error_code(None))
            request = self._request(trajectory.joint_trajectory)
            if request is None:
                return ExecuteTrajectory.Result(error_code=error_code(None))
            self._started(run, request)
        self._follow(run, run.name, ExecuteTrajectory.Feedback)
        return ExecuteTrajectory.Result(error_code=error_code(None))

    def _grip(self, joint_trajectory: Any, run: Run) -> bool:
        """Carry out the trajectory of a gripper; returns whether it is one."""
        name = self._grippers.of_trajectory(joint_trajectory.joint_names)
        if name is not None:
            self._grippers.execute(name, joint_trajectory, run)
        return name is not None

    def _request(self, joint_trajectory: Any) -> ExecuteRequest | None:
        """What the executor is to do for a trajectory; None if that is nothing."""
        if (plan_id := self.plans.found(joint_trajectory)) is not None:
            return ExecuteRequest(plan_id=plan_id)
        motion = trajectory_of(
            joint_trajectory, self._engine.joints, self._frames.joints, "trajectory.joint_trajectory"
        )
        return None if motion is None else ExecuteRequest(trajectory=motion)

    def _started(self, run: Run, request: ExecuteRequest, *, replan: bool = False) -> None:
        run.go_on()
        self._engine.client.start(request, goal_id=run.name, replan=replan, timeout=ANSWER_SECONDS)

    def _follow(self, run: Run, goal_id: str, feedback: type[Any]) -> None:
        """Wait for the end of the goal. Raises its error."""
        run.handle.publish_feedback(feedback(state="MONITOR"))
        *_, state = run.follow(goal_id)
        if state.problem is not None:
            raise self._engine.terms.of_error(from_problem(state.problem))
        if state.status != "succeeded":
            raise Cancelled("the motion was ended before the robot had reached the goal")

    def _not_moved(self, error: ZarmError, text: str) -> MoveGroup.Result:
        self._report("move_action", text)
        return MoveGroup.Result(error_code=error_code(error))

    def _not_moved_in_sequence(self, error: ZarmError, text: str) -> MoveGroupSequence.Result:
        self._report("sequence_move_group", text)
        result = MoveGroupSequence.Result()
        result.response.error_code = error_code(error)
        return result

    def _not_executed(self, error: ZarmError, text: str) -> ExecuteTrajectory.Result:
        self._report("execute_trajectory", text)
        return ExecuteTrajectory.Result(error_code=error_code(error))

    def _report(self, action: str, text: str) -> None:
        self._log.warning(f"{action}: {text}")

    def _event(self, message: String) -> None:
        """`stop` ends the motion that runs, whoever started it."""
        if message.data == "stop":
            threading.Thread(target=self._stop, name="trajectory_execution_event").start()
        else:
            self._log.warning(f"trajectory_execution_event has no meaning for {message.data!r}; it knows stop")

    def _stop(self) -> None:
        if (run := self._turns.running) is not None:
            run.preempt()
        try:
            self._engine.client.stop()
        except ZarmError as error:
            self._log.warning(f"trajectory_execution_event: {error}")


def _executes(goal: Any) -> bool:
    return not goal.planning_options.plan_only


def _digest(names: Sequence[str], position: Any, times: Sequence[float]) -> str:
    rows = np.ascontiguousarray(position, np.float64)
    rounded = np.round(np.ascontiguousarray(times, np.float64) * 1e9).astype(np.int64)
    return hashlib.sha256(",".join(names).encode() + rows.tobytes() + rounded.tobytes()).hexdigest()
