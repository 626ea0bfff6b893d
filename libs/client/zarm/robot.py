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
from zarm_contract.messages import ExecutorState, Health, JointState, Nothing

if TYPE_CHECKING:
    from zarm.recording import Recorder

_MEASURED_SECONDS = 2.0


class Robot(Planning, Kinematics, ClosedLoop):
    """One robot on the bus; `zarm.connect` makes it.

    Joint vectors follow the order of `joints` in the robot's descriptor. Poses are those of its tip in its base frame.
    Every method raises a `zarm.Error`: the problem that the service answers, or Unavailable if none answers.
    Thread-safe; Ctrl-C interrupts only the main thread.
    """

    def __init__(self, connection: Connection) -> None:
        super().__init__(connection)
        self.scene = Scene(connection)

    def state(self) -> ExecutorState:
        """The present state of the executor."""
        return self.connection.read(self._keys.executor_state)

    def states(self) -> Generator[ExecutorState]:
        """The present state of the executor, then every change; endless."""
        return self.connection.latched(self._keys.executor_state)

    def joint_state(self) -> JointState:
        """The next measured joint state (rad, rad/s). Raises ExecutionRefused (`no_joint_state`) if none arrives."""
        state = self.connection.next(self._keys.joint_states, _MEASURED_SECONDS)
        if state is None:
            raise ExecutionRefused(
                f"no joint state of {self.name} came within {_MEASURED_SECONDS:g} s; `zarm status` shows whether its executor "
                "runs and with which strategy",
                code="no_joint_state",
            )
        return state

    def joint_states(self) -> Generator[JointState]:
        """Measured joint states (rad, rad/s), endless; a loop that is slower gets the newest."""
        return self.connection.published(self._keys.joint_states)

    def tip(self) -> Pose:
        """The present pose of the tip."""
        return self.fk([self.joint_state().position])[0]

    def health(self, service: str, *, timeout: float = ANSWER_SECONDS) -> Health:
        """The health of a service: `planner`, `executor`, ..."""
        return self._ask(self._keys.health(service), Nothing(), timeout=timeout)

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
