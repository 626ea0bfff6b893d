"""The parameters of the node: their ranges and their values."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from zarm_contract.errors import InvalidRequest, ZarmError
from zarm_contract.messages import MAX_OBJECTS
from zarm_ros_bridge.answers import shortened
from zarm_ros_bridge.engine import Engine

log = logging.getLogger(__name__)

PLANNERS = ("classic", "mpc", "batch", "constrained", "multipoint", "joint_space", "retarget")
"""The values of `planner_type`, each at its number in curobo_msgs/srv/SetPlanner."""
AVAILABLE = "node_is_available"


@dataclass(frozen=True)
class _Declared:
    """One parameter. `range` is inclusive; without `writable` it cannot be changed while the bridge runs."""

    name: str
    value: bool | int | float | str
    description: str
    range: tuple[float, float] | None = None
    choices: tuple[str, ...] = ()
    writable: bool = True

    def descriptor(self) -> ParameterDescriptor:
        described = ParameterDescriptor(
            name=self.name,
            description=self.description,
            read_only=not self.writable,
            additional_constraints=f"one of {', '.join(self.choices)}" if self.choices else "",
        )
        if self.range is not None:
            low, high = self.range
            if isinstance(self.value, int):
                described.integer_range = [IntegerRange(from_value=int(low), to_value=int(high))]
            else:
                described.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
        return described


def robot_type(engine: Engine, strategy: str) -> str:
    """The value of `robot_type` for a control strategy: the robot's own type means whole trajectories to its
    controller.
    """
    return engine.robot.descriptor.name if strategy == "joint_trajectory" else strategy


def _declared(engine: Engine) -> Iterator[_Declared]:
    descriptor = engine.robot.descriptor
    # What robot is running
    yield _Declared("robot", engine.keys.robot, "The robot's name on the bus.", writable=False)
    yield _Declared("robot_config_file", str(engine.robot.path), "The robot's descriptor.", writable=False)
    yield _Declared("base_link", descriptor.base_link, "The frame of all poses.", writable=False)
    # How commands reach it
    yield _Declared(
        "control_strategy",
        descriptor.strategy,
        "How commands reach the robot; a change switches at once, or is refused.",
    )
    yield _Declared(
        "robot_type",
        robot_type(engine, descriptor.strategy),
        "What moves once set_robot_strategy (std_srvs/srv/Trigger) is called.",
    )
    yield _Declared("preempt", False, "Whether a goal takes the place of one that runs; else it is rejected.")
    yield _Declared(
        "replan_in_motion", False, "Whether a goal is planned anew, in motion, when something is put in its way."
    )
    yield _Declared(
        "time_dilation_factor", 0.5, "Time between two feedbacks, in units of 0.2 s; 0.1 s at least.", (0.01, 10.0)
    )
    # Options of plan requests
    yield _Declared("planner_type", PLANNERS[0], "The planner of the next plans.", choices=PLANNERS)
    yield _Declared("max_attempts", 1, "Searches after which planning gives up.", (1, 1000))
    yield _Declared("timeout", 5.0, "Deadline of planning (s).", (0.01, 60.0))
    yield _Declared(
        "collision_activation_distance",
        0.025,
        "Kept to objects on the way by plans (m).",
        (0.0, 0.2),
    )
    yield _Declared(
        "world_file", "", "A scene of zarm or a world of cuRobo (YAML); a change loads it in place of the objects."
    )
    yield _Declared("voxel_size", 0.05, "Edge of a voxel of get_voxel_grid (m).", (0.005, 1.0))
    for kind, capacity in (("obb", 100), ("mesh", 100), ("blox", 10)):
        yield _Declared(f"{kind}_cache_size", capacity, f"Room for obstacles of the kind {kind}.", (0, MAX_OBJECTS))
    # Closed loop: read when a goal begins
    yield _Declared("convergence_threshold", 0.01, "Distance from which a goal is on target (m).", (0.0001, 1.0))
    yield _Declared("convergence_threshold_rad", 0.05, "Turn from which a goal is on target (rad).", (0.0001, 3.0))
    yield _Declared("convergence_hold_steps", 1, "Steps within both thresholds till it is on target.", (1, 10_000))
    yield _Declared("max_mpc_iterations", 1000, "Steps after which mpc_move gives up.", (1, 1_000_000))
    yield _Declared("mpc_step_dt", 0.03, "Duration of a step (s), in generations B and C.", (0.001, 1.0))
    yield _Declared("mpc_horizon_steps", 30, "Steps that mpc_predicted_path shows at most, in B and C.", (1, 1000))
    yield _Declared("mpc_control_frequency", 50.0, "Steps in a second (Hz), in generation A.", (1.0, 500.0))
    yield _Declared("mpc_horizon", 30, "As mpc_horizon_steps, in generation A.", (1, 1000))
    # What is reported
    yield _Declared(AVAILABLE, False, "Whether planner and executor have been ready; nobody else sets it.")


class Parameters:
    """Declares every parameter on `node`. An invalid value is refused with the reason, and nothing changes.

    Thread-safe.
    """

    def __init__(self, node: Node, engine: Engine) -> None:
        self._node = node
        self._effects: dict[str, Callable[[Any], None]] = {}
        self._settled: dict[str, Callable[[], None]] = {}
        self._mine = threading.local()
        self._choices = {}
        for one in _declared(engine):
            node.declare_parameter(one.name, one.value, one.descriptor())
            if one.choices:
                self._choices[one.name] = one.choices
        node.add_on_set_parameters_callback(self._admit)
        node.add_post_set_parameters_callback(self._settle)

    def value(self, name: str) -> Any:
        """The present value."""
        return self._node.get_parameter(name).value

    def set(self, name: str, value: Any) -> None:
        """Show the engine's present state, without an effect on it. Raises InvalidRequest for an invalid value."""
        self._mine.showing = True
        try:
            result = self._node.set_parameters_atomically([Parameter(name, value=value)])
        finally:
            self._mine.showing = False
        if not result.successful:
            raise InvalidRequest(result.reason, field=name)

    def on_change(self, name: str, effect: Callable[[Any], None], settled: Callable[[], None] | None = None) -> None:
        """Call `effect(value)` before a client's change of `name` is accepted; its ZarmError refuses the change. Call
        `settled()` after.
        """
        self._effects[name] = effect
        if settled is not None:
            self._settled[name] = settled

    def _admit(self, changes: list[Parameter]) -> SetParametersResult:
        # rclpy has already checked types, ranges and read-only parameters.
        try:
            for change in changes:
                self._check(change)
            if not self._is_mine():
                self._apply(changes)
        except ZarmError as error:
            return SetParametersResult(successful=False, reason=shortened(str(error)))
        except Exception:  # as on the bus, one request fails and the service continues; rclpy would end the thread
            log.exception("parameters failed names=%s", ",".join(change.name for change in changes))
            reason = "the ROS bridge failed on this change; its log has the trace"
            return SetParametersResult(successful=False, reason=reason)
        return SetParametersResult(successful=True)

    def _settle(self, changes: list[Parameter]) -> None:
        if not self._is_mine():
            for change in changes:
                if change.name in self._settled:
                    self._settled[change.name]()

    def _is_mine(self) -> bool:
        return getattr(self._mine, "showing", False)

    def _check(self, change: Parameter) -> None:
        choices = self._choices.get(change.name)
        if choices is not None and change.value not in choices:
            raise InvalidRequest(
                f"{change.name} cannot be {change.value!r} for this robot; choose one of {', '.join(choices)}"
            )

    def _apply(self, changes: list[Parameter]) -> None:
        effects = [(change, self._effects[change.name]) for change in changes if change.name in self._effects]
        if len(effects) > 1:
            names = ", ".join(change.name for change, _ in effects)
            raise InvalidRequest(f"{names} cannot be changed together; change one at a time")
        for change, effect in effects:
            effect(change.value)
            log.info("parameter name=%s value=%s", change.name, change.value)
