"""How a ROS client leaves a fault."""

from __future__ import annotations

from std_srvs.srv import Trigger

from zarm_ros_bridge.answers import with_message
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.ros import Ros


class Faults:
    """reset_fault, which the reference lacks because it has no faults.

    No other ROS call leaves a fault, not even a switch of the strategy: a script that switches before every goal would
    otherwise move a robot that still has to be inspected.
    """

    def __init__(self, ros: Ros, engine: Engine) -> None:
        self._engine = engine
        ros.serve(Trigger, "~/reset_fault", with_message(self._reset))

    def _reset(self, _: Trigger.Request, __: Trigger.Response) -> str:
        problem = self._engine.client.state().problem
        self._engine.client.reset()
        return f"reset; what was wrong: {self._engine.terms.of(problem.message)}" if problem else "nothing was wrong"
