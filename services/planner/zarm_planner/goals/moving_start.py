"""A start in motion: whether it is valid, and collision-free braking from it.

The path of a plan begins where the braking comes to rest; smoothing in time then skips the rest where there is room.
"""

from __future__ import annotations

from functools import partial
from itertools import chain, product

import numpy as np

from zarm_contract.errors import InvalidRequest, PlanningFailed
from zarm_contract.messages import StartState
from zarm_geometry.robot_model import RobotModel
from zarm_planner.context import PlanningContext
from zarm_planner.goals.ends import End, check_start, rest_end
from zarm_planner.goals.joints import checked
from zarm_planner.timing.lead_in import LeadIn, ways_to_rest
from zarm_planner.timing.smoothing import brake_to_rest
from zarm_planner.verification.verify import LOAD, RANGE, VerificationFailed, verify
from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import Limits

_SHARES = (1.0, 0.98)
"""Shares of the acceleration limits tried for braking. Knots closer to each other than `sampling.CLOSE` are merged, which
lets the acceleration overshoot by up to 1 %.
"""


def state_of(model: RobotModel, limits: Limits, start: StartState) -> Array:
    """The state (3, dof) of a request. Raises InvalidRequest if it is outside the joint ranges or `limits`."""
    rows = ("position", "velocity", "acceleration")
    state = np.stack([checked(model, getattr(start, row), f"start_state.{row}") for row in rows])
    least = np.stack((model.lower - RANGE, -limits.velocity * LOAD, -limits.acceleration * LOAD**2))
    most = np.stack((model.upper + RANGE, limits.velocity * LOAD, limits.acceleration * LOAD**2))
    for k, j in np.argwhere((state < least) | (state > most)).tolist():
        joint = model.robot.descriptor.joints[j]
        raise InvalidRequest(
            f"the {rows[k]} of {joint} is {state[k, j]:.4f}, outside its limits, {least[k, j]:.4f} to {most[k, j]:.4f}; "
            "give a state inside them" + (f", or raise {rows[k]}_scale" if k else ""),
            field=f"start_state.{rows[k]}.{j}",
            joint=joint,
        )
    return state


def moving_start(context: PlanningContext, state: Array, *, vias: bool) -> tuple[LeadIn, End]:
    """A verified way to brake from `state` (3, dof), and its end at rest; `vias` as in `ways_to_rest`.

    Raises PlanningFailed: `start_in_collision`, or `no_path` if every braking tried breaks a limit or collides.
    """
    check_start(context, state[0], "start_state")
    failure: VerificationFailed | None = None
    ways = partial(
        ways_to_rest, context.model, context.world, state, context.limits, context.dt, vias=vias, seed=context.seed
    )
    for lead_in in chain.from_iterable(ways(share=share, soon=soon) for soon, share in product((False, True), _SHARES)):
        context.deadline.check()
        trajectory = brake_to_rest(context.model, context.world, lead_in, context.limits, context.dt)
        try:
            verify(
                trajectory,
                state[0],
                lead_in.rest,
                context.limits,
                context.exact,
                context.deadline.check,
                motion=state[1:],
            )
        except VerificationFailed as error:
            failure = failure or error
            continue
        if (end := rest_end(context, lead_in.rest, None)) is not None:
            return lead_in, end
    reason = str(failure or "a joint would leave its range")
    raise PlanningFailed(
        f"no braking motion from the start can be used: {reason}; give a state from which the robot can still brake",
        code="no_path",
        field="start_state",
    )
