"""Plans as JSON: most numbers of a trajectory are rounded, and these are written faster than numbers in general."""

from __future__ import annotations

from typing import Any

import orjson

from zarm_contract.messages import Plan, Trajectory
from zarm_planner.kernels.decimals import write_inner_rows
from zarm_planner.timing.rounding import DECIMALS


def written(plan: Plan) -> Plan:
    """The same plan for `zarm_contract.codec.encode`, the samples of its trajectory, which are arrays, as JSON text."""
    trajectory: Any = plan.trajectory
    rows = trajectory.position, trajectory.velocity, trajectory.acceleration
    position, velocity, acceleration = (
        _whole(values, inner.tobytes()) if len(inner) else values
        for values, inner in zip(rows, write_inner_rows(*rows, DECIMALS), strict=True)
    )
    samples: dict[str, Any] = {"position": position, "velocity": velocity, "acceleration": acceleration}
    text = Trajectory.model_construct(joint_names=trajectory.joint_names, time=trajectory.time, **samples)
    return plan.model_copy(update={"trajectory": text})


def _whole(values: Any, inner: bytes) -> orjson.Fragment:
    """The text of all rows, of which only the first and the last are not in `inner` yet."""
    first, last = (orjson.dumps(row, option=orjson.OPT_SERIALIZE_NUMPY) for row in (values[0], values[-1]))
    return orjson.Fragment(b"".join((b"[", first, b",", inner, last, b"]")))
