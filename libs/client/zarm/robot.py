"""One robot: plans, kinematics, motion and its live state."""

from __future__ import annotations

from collections.abc import Generator
from pathlib import Path
from typing import TYPE_CHECKING

from zarm.closed_loop import ClosedLoop
from zarm.connection import ANSWER_SECONDS, Connection
from zarm.kinematics import Kinematics
from zarm.planning import Planning
from zarm.scene import Scene
from zarm.values import Pose
from zarm_contract.errors import ExecutionRefused
from zarm_contract.messages import ExecutorState, Health, JointState

if TYPE_CHECKING:
    from zarm.recording import Recorder

_MEASURED_SECONDS = 2.0


class Robot(Planning, Kinematics, ClosedLoop):
    """One robot on the bus; `zarm.connect` makes it.

    Joint vectors follow the order of `joints` in the robot's descriptor. Poses are of its tip in its base frame. Every method
    raises a `zarm.Error`: what the service answers, or Unavailable where none answers. Safe from any thread; Ctrl-C interrupts
    only the main one.
    """

    def __init__(self, connection: Connection) -> None:
        super().__init__(connection)
        self.scene = Scene(connection)

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
