"""The list of planners, and the choice of one for a request."""

from __future__ import annotations

from collections.abc import Sequence

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import Goal
from zarm_planner.planners.base import Planner
from zarm_planner.planners.cartesian import CartesianPlanner
from zarm_planner.planners.constrained import ConstrainedPlanner
from zarm_planner.planners.free import FreePlanner

PLANNERS: tuple[Planner, ...] = (
    FreePlanner(),
    ConstrainedPlanner(),
    CartesianPlanner(),
)
"""Add new planners here. The first that fits is the default when a request names none."""

AUTO = "auto"
"""The name with which a request leaves the choice to its goal."""


def choose(
    name: str, goal: Goal, constrained: bool, moving: bool = False, planners: Sequence[Planner] = PLANNERS
) -> Planner:
    """The planner that takes a request; `constrained`: with a path constraint, `moving`: with a start in motion.

    Raises InvalidRequest if there is none called `name`, or if it does not take it.
    """
    fitting: dict[str, Planner] = {}
    for planner in planners:
        if goal.kind in planner.names and planner.constrained >= constrained and planner.moving >= moving:
            fitting.setdefault(planner.names[goal.kind], planner)
    if not fitting and moving:
        raise InvalidRequest(
            "no planner supports a start in motion with a path constraint; leave one of them out", field="start_state"
        )
    chosen = next(iter(fitting), name) if name == AUTO else name
    if chosen not in fitting:
        kind = f"{goal.kind} with a path constraint" if constrained else goal.kind
        unfit = (
            f"the planner {name} takes no goal of kind {kind}"
            if name in names_of(planners)
            else f"there is no planner {name}"
        )
        raise InvalidRequest(f"{unfit}; ask for {' or '.join((*fitting, AUTO))}", field="planner")
    return fitting[chosen]


def names_of(planners: Sequence[Planner]) -> tuple[str, ...]:
    """The names that a request may give, each once."""
    return tuple(dict.fromkeys((AUTO, *(name for planner in planners for name in planner.names.values()))))


def check_name(name: str, planners: Sequence[Planner] = PLANNERS) -> None:
    """Raises InvalidRequest unless there is a planner of this name, for some kind of goal."""
    known = names_of(planners)
    if name not in known:
        raise InvalidRequest(f"there is no planner {name}; choose one of {', '.join(known)}", field="planner")
