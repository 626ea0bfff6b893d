"""The planners that move_group offers, by their names in MoveIt, and their parameters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from moveit_msgs.msg import PlannerInterfaceDescription, PlannerParams
from moveit_msgs.srv import GetPlannerParams, QueryPlannerInterfaces, SetPlannerParams

from zarm_contract.errors import InvalidRequest, ZarmError
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.ros import Ros

PIPELINES: Mapping[str, tuple[str, ...]] = {
    "zarm": ("free",),
    "pilz_industrial_motion_planner": ("PTP", "LIN", "CIRC", "POLYLINE"),
}
"""The names of planners by pipeline. `free` and `PTP` go on any free path to the goal; the others along a line, an arc and a polyline."""
SETTINGS: Mapping[str, str] = {
    "timeout": "Deadline of planning (s).",
    "max_attempts": "Searches after which planning gives up.",
    "optimize_s": "Time in which a plan is made faster, while no other request waits (s).",
    "velocity_scale": "Share of the velocity limits.",
    "acceleration_scale": "Share of the acceleration limits.",
    "margin": "Distance kept to objects on the way (m).",
}
"""What `get_planner_params` reports and `set_planner_params` changes, for all pipelines and planners."""


def along(pipeline: str, planner: str) -> str | None:
    """`LIN`, `CIRC` or `POLYLINE` where the tip is to move along a curve, else None: other planners go on any free path."""
    name = planner.upper()
    return name if name in ("LIN", "CIRC", "POLYLINE") and pipeline in ("", *PIPELINES) else None


class Planners:
    """query_planner_interface, get_planner_params and set_planner_params: the settings of the planner."""

    def __init__(self, ros: Ros, engine: Engine) -> None:
        self._planner = engine.client
        self._log = ros.node.get_logger()
        ros.serve(QueryPlannerInterfaces, "query_planner_interface", self._query)
        ros.serve(GetPlannerParams, "get_planner_params", self._get)
        ros.serve(SetPlannerParams, "set_planner_params", self._set)

    def _query(self, _: Any, response: Any) -> Any:
        response.planner_interfaces = [
            PlannerInterfaceDescription(name=pipeline, pipeline_id=pipeline, planner_ids=list(names))
            for pipeline, names in PIPELINES.items()
        ]
        return response

    def _get(self, _: Any, response: Any) -> Any:
        try:
            settings = self._planner.settings()
        except ZarmError as error:
            self._log.warning(f"get_planner_params: {error}")
            return response
        response.params = PlannerParams(
            keys=list(SETTINGS),
            values=[str(getattr(settings, name)) for name in SETTINGS],
            descriptions=list(SETTINGS.values()),
        )
        return response

    def _set(self, request: Any, response: Any) -> Any:
        try:
            self._planner.settings(**_changes(request.params))
        except ZarmError as error:
            self._log.error(f"set_planner_params: {error}")
        return response


def _changes(params: Any) -> dict[str, Any]:
    changes: dict[str, Any] = {}
    for name, value in zip(params.keys, params.values, strict=False):
        if name not in SETTINGS:
            raise InvalidRequest(f"{name} is no parameter; choose among {', '.join(SETTINGS)}", field="params.keys")
        try:
            changes[name] = int(value) if name == "max_attempts" else float(value)
        except ValueError as error:
            raise InvalidRequest(f"{name}: {value!r} is not a number", field="params.values") from error
    return changes
