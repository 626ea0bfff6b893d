"""display_planned_path: the plans, for RViz."""

from __future__ import annotations

from moveit_msgs.msg import DisplayTrajectory

from zarm_contract.messages import Plan
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.moveit.states import robot_trajectory, trajectory_start
from zarm_ros_bridge.ros import Ros
from zarm_runtime.publications import deliver


class PlannedPaths:
    """Publishes each plan, whoever asked for it, while somebody looks."""

    def __init__(self, ros: Ros, engine: Engine) -> None:
        self._robot = engine.robot.descriptor
        self._publisher = ros.node.create_publisher(DisplayTrajectory, "display_planned_path", 10)
        engine.bus.listen(engine.keys.plans, self._plan)

    def _plan(self, key: str, payload: bytes) -> None:
        if self._publisher.get_subscription_count():
            deliver(key, payload, Plan, lambda _, plan: self._show(plan))

    def _show(self, plan: Plan) -> None:
        self._publisher.publish(
            DisplayTrajectory(
                model_id=self._robot.name,
                trajectory=[robot_trajectory(plan, self._robot.base_link)],
                trajectory_start=trajectory_start(plan),
            )
        )
