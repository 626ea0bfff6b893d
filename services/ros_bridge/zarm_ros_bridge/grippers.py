"""Where the fingers of a robot's grippers are."""

from __future__ import annotations

import threading

from zarm_contract.messages import GripperState, JointState
from zarm_ros_bridge.engine import Engine


class Grippers:
    """The positions of the grippers' joints as the executor publishes them; open until it does. Thread-safe."""

    def __init__(self, engine: Engine) -> None:
        self._robot = engine.robot
        self._widths: dict[str, float] = {}
        self._lock = threading.Lock()
        self._positions = self._robot.gripper_positions({})
        if self._positions:
            engine.bus.watch(engine.keys.gripper_state("*"), self._receive)

    def positions(self) -> dict[str, float]:
        """The position (rad, m) of each joint."""
        return self._positions

    def beside(self, state: JointState) -> JointState:
        """Joints with those of the grippers, whose efforts are not measured: 0."""
        fingers = {name: at for name, at in self._positions.items() if name not in state.joint_names}
        if not fingers:
            return state
        return JointState(
            stamp=state.stamp,
            joint_names=(*state.joint_names, *fingers),
            position=(*state.position, *fingers.values()),
            velocity=(*state.velocity, *(0.0 for _ in fingers)),
            effort=None if state.effort is None else (*state.effort, *(0.0 for _ in fingers)),
        )

    def _receive(self, _: str, state: GripperState) -> None:
        if state.width is None:
            return
        with self._lock:
            self._widths[state.gripper] = state.width
            self._positions = self._robot.gripper_positions(self._widths)
