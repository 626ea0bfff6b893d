"""What the local controller steers for: the live target or, when stuck, a point on a global plan."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future

import numpy as np

from zarm_contract.errors import Busy, DeadlineExceeded, InternalError, Problem, Unavailable, ZarmError
from zarm_contract.messages import SceneRevision
from zarm_geometry.robot_model import RobotModel
from zarm_servo.kernels.step import PERIOD
from zarm_servo.tracking.global_plan import TIMEOUT, GlobalPlan
from zarm_servo.tracking.targets import JointTarget, PoseTarget, Target, rotation_vector
from zarm_trajectory.arrays import Array

Find = Callable[[PoseTarget | JointTarget, Array, float, float], GlobalPlan]
"""Finds a plan to a target from a position (J,) that is the given distance (m) away from it, within a time limit (s).
Raises ZarmError if there is none.
"""
Free = Callable[[Array, Array], bool]
"""Whether the straight line between two positions (J,) keeps the margin."""

_STUCK = 0.4
"""A robot is stuck if it has moved by less than `_MOVED` for this long (s)."""
_MOVED = 0.01
"""rad, of the joint that moves most."""
_RATE_OVER = 1.0
"""Window (s) over which the rate of approach to a target is measured."""
_SLOWDOWN = 3.0
"""A robot also counts as stuck if it needs longer than this (s) at that rate to reach a static target, as near a
singularity.
"""
_PER_RAD = 0.2
"""Distance in m that counts as much as one rad of rotation."""
_REACHED = 0.0005, 0.005, 0.001
"""m, rad, rad of a joint: closer than this, no plan is needed."""
_REFRESHED = 0.2
"""Interval (s) at which a plan to a moving target is requested."""
_UNMOVED_TOLERANCES = 0.001, 0.01, 0.001
"""m, rad, rad of a joint: a target that has moved by less than this counts as unmoved."""
_JUMPS = 0.1, 0.5, 0.3
"""m, rad, rad of a joint: a target further than this from the end of a plan has jumped, and the plan is obsolete."""
_ARRIVED = 0.1
"""This close (rad) to the end of a plan to a moving target, the robot follows the target directly again."""
_STEER_DISTANCES = 0.8, 0.4, 0.2, 0.1, 0.05
"""Distances (rad) ahead on the plan of the point to steer for: the first one reached by a free straight line is used.
"""
_STEPS_PER_CHOICE = 5
"""Steps after which the point is chosen again."""
_ATTEMPTS = 4
"""Plans tried per target and scene; if the robot gets stuck on all of them, it stays at rest."""
_TIMEOUTS = TIMEOUT, 8 * TIMEOUT
"""Time limit (s) of the planner for a target, at first and at most: it doubles each time it runs out. A planner that
timed out or did not answer is asked again twice its time limit after it was asked.
"""


class LocalGoal:
    """Decides step by step for one robot; `find` runs in `pool`.

    One call counts at a time. If the target jumps meanwhile, its plan is of no use: it is not waited for.
    """

    def __init__(self, model: RobotModel, find: Find, free: Free, pool: Executor) -> None:
        self._model, self._find, self._free = model, find, free
        self._pool = pool
        self._asked: Future[GlobalPlan] | None = None
        self._asked_for: PoseTarget | JointTarget | None = None
        self._plan: GlobalPlan | None = None
        self._point: Array | None = None
        self._steps = self._asked_at = 0
        self._anchor, self._anchored = np.full(model.dof, np.inf), 0
        self._before: tuple[int, PoseTarget | JointTarget | None, float] = 0, None, np.inf
        self._attempts, self._timeout = 0, _TIMEOUTS[0]
        self._revision: SceneRevision | None = None
        self.problem: Problem | None = None

    @property
    def planned(self) -> bool:
        """Whether the robot follows a global plan."""
        return self._plan is not None

    def target(self, wanted: Target | None, position: Array, revision: SceneRevision | None) -> Target | None:
        """What to steer for on the way to `wanted`, from `position` (J,), in the scene of this revision."""
        self._steps += 1
        self._watch(position)
        if not isinstance(wanted, PoseTarget | JointTarget):
            self._forget()
            return wanted
        self._compare(wanted, revision)
        self._take()
        plan = self._plan
        if plan is not None and _leads_to(plan, wanted):
            plan = self._plan = None
        if self._must_ask(wanted, position, revision):
            distance = self._errors(wanted, position)[0]
            self._asked, self._asked_for, self._asked_at = (
                self._pool.submit(self._find, wanted, position.copy(), distance, self._timeout),
                wanted,
                self._steps,
            )
            self._revision, self._anchored = revision, self._steps
            self._attempts += 1
        return wanted if plan is None else JointTarget(self._ahead(plan, position))

    def _watch(self, position: Array) -> None:
        if np.abs(position - self._anchor).max() > _MOVED:
            self._anchor, self._anchored = position.copy(), self._steps

    def _compare(self, wanted: PoseTarget | JointTarget, revision: SceneRevision | None) -> None:
        """If the target or the scene has changed, allow all attempts again."""
        if (
            self._asked_for is None
            or revision != self._revision
            or _apart(wanted, self._asked_for, _UNMOVED_TOLERANCES)
        ):
            self._attempts, self._timeout = 0, _TIMEOUTS[0]
            self.problem = None
        if self._asked is not None and self._asked_for is not None and _apart(wanted, self._asked_for, _JUMPS):
            self._asked.cancel()
            self._asked = None

    def _take(self) -> None:
        """Take the requested plan once it is ready."""
        asked = self._asked
        if asked is None or not asked.done():
            return
        self._asked = None
        error = asked.exception()
        self._plan = asked.result() if error is None else None
        if self._plan is not None:
            self._point, self._anchored = None, self._steps
            error = self._plan.refusal
        if error is None:
            return
        known = error if isinstance(error, ZarmError) else InternalError(f"{type(error).__name__}: {error}")
        self.problem = known.problem
        self._attempts = 0 if isinstance(error, Busy | DeadlineExceeded | Unavailable) else _ATTEMPTS
        if isinstance(error, DeadlineExceeded):
            self._timeout = min(2 * self._timeout, _TIMEOUTS[1])

    def _must_ask(self, wanted: PoseTarget | JointTarget, position: Array, revision: SceneRevision | None) -> bool:
        since = (self._steps - self._asked_at) * PERIOD
        if self._asked is not None or self._attempts >= _ATTEMPTS or since < _REFRESHED:
            return False
        if self.problem is not None and since < 2 * self._timeout:
            return False
        plan = self._plan
        if plan is not None and (revision != self._revision or _apart(wanted, plan.target, _UNMOVED_TOLERANCES)):
            return True
        if plan is None and self._too_slow(wanted, position):
            return True
        if (self._steps - self._anchored) * PERIOD < _STUCK or (plan is not None and plan.left < _MOVED):
            return False
        return bool(np.any(np.greater(self._errors(wanted, position), _REACHED)))

    def _too_slow(self, wanted: PoseTarget | JointTarget, position: Array) -> bool:
        """Whether a static target is too long away at the present rate of approach; reported once per `_RATE_OVER`."""
        since, before, left_before = self._before
        if (self._steps - since) * PERIOD < _RATE_OVER:
            return False
        errors = self._errors(wanted, position)
        left = errors[0] + _PER_RAD * errors[1] + errors[2]
        rests = before is not None and not _apart(wanted, before, _UNMOVED_TOLERANCES)
        self._before = self._steps, wanted, left if rests else np.inf
        late = left_before < np.inf and left > _SLOWDOWN * (left_before - left) / _RATE_OVER
        return rests and late and bool(np.any(np.greater(errors, _REACHED)))

    def _errors(self, wanted: PoseTarget | JointTarget, position: Array) -> tuple[float, float, float]:
        if isinstance(wanted, JointTarget):
            return 0.0, 0.0, float(np.abs(wanted.distance(self._model, position)).max())
        error = wanted.error(self._model.fk_tip(position, wanted.group), wanted.pose)
        return float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:])), 0.0

    def _ahead(self, plan: GlobalPlan, position: Array) -> Array:
        if self._point is None or self._steps % _STEPS_PER_CHOICE == 0:
            plan.advance(position, _STEER_DISTANCES[0])
            points = [plan.ahead(length) for length in _STEER_DISTANCES]
            self._point = next((point for point in points[:-1] if self._free(position, point)), points[-1])
        return self._point

    def _forget(self) -> None:
        self._plan = self._asked_for = self.problem = None
        self._attempts, self._anchored = 0, self._steps
        self._before = self._steps, None, np.inf
        if self._asked is not None and self._asked.done():
            self._asked = None


def _leads_to(plan: GlobalPlan, wanted: PoseTarget | JointTarget) -> bool:
    """Whether a plan has served its purpose: it leads elsewhere, or the target can be followed directly from here."""
    if _apart(wanted, plan.target, _JUMPS):
        return True
    return plan.left < _ARRIVED and (plan.refusal is not None or _apart(wanted, plan.target, _UNMOVED_TOLERANCES))


def _between(a: Array, b: Array) -> tuple[float, float]:
    """Distance between two poses (4, 4): m, rad."""
    return float(np.linalg.norm(a[:3, 3] - b[:3, 3])), float(np.linalg.norm(rotation_vector(a[:3, :3] @ b[:3, :3].T)))


def _apart(a: PoseTarget | JointTarget, b: PoseTarget | JointTarget, limits: tuple[float, float, float]) -> bool:
    """Whether two targets are further apart than these limits: m, rad, rad of a joint."""
    if isinstance(a, PoseTarget) and isinstance(b, PoseTarget):
        return (a.tolerance, a.group) != (b.tolerance, b.group) or bool(
            np.any(np.greater(_between(a.pose, b.pose), limits[:2]))
        )
    if isinstance(a, JointTarget) and isinstance(b, JointTarget):
        return float(np.abs(a.position - b.position).max()) > limits[2]
    return True
