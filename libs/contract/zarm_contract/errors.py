"""Errors: one model on the wire, one exception tree in the code.

ZarmError                       carries a Problem; every error that a user meets is one of these
├── InvalidRequest              the request cannot be read or breaks a rule; nothing was done
├── PlanningFailed              unreachable, start_in_collision, goal_in_collision, no_path
├── DeadlineExceeded            timeout
├── ExecutionRefused            stale_plan, start_state_mismatch, no_joint_state, limit_violated
├── ExecutionFailed             tolerance_violated, driver_stalled, collision_detected
├── Cancelled                   cancelled
├── Busy                        busy
├── Unavailable                 unavailable: no answer, no router, no such service
└── InternalError               internal: a fault of zarm; the trace is in the service's log
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal, NamedTuple, get_args

from zarm_contract._model import Message

Code = Literal[
    "invalid_request",
    "unreachable",
    "start_in_collision",
    "goal_in_collision",
    "no_path",
    "timeout",
    "stale_plan",
    "start_state_mismatch",
    "no_joint_state",
    "limit_violated",
    "busy",
    "unavailable",
    "tolerance_violated",
    "driver_stalled",
    "collision_detected",
    "cancelled",
    "internal",
]


class Meaning(NamedTuple):
    """What a code says, and what to do about it."""

    means: str
    remedy: str


MEANINGS: Mapping[Code, Meaning] = {
    "invalid_request": Meaning(
        "The request cannot be read or breaks a rule. Nothing was done.", "Correct the field that it names."
    ),
    "unreachable": Meaning("There is no joint solution for the pose.", "Move the goal, or choose another orientation."),
    "start_in_collision": Meaning(
        "The measured or given start touches something.", "Move the robot free, or correct the scene."
    ),
    "goal_in_collision": Meaning("The goal touches something.", "Move the goal, or correct the scene."),
    "no_path": Meaning("The search found no path.", "Allow more attempts or time, or clear the scene."),
    "timeout": Meaning("The deadline of the request passed.", "Give a longer `timeout`."),
    "stale_plan": Meaning(
        "The scene or the robot has changed since the plan was made or the paused goal was started.",
        "Plan again. Cancel a paused goal first.",
    ),
    "start_state_mismatch": Meaning(
        "The robot is not at the start of the trajectory.", "Plan again from where the robot is."
    ),
    "no_joint_state": Meaning("There is no fresh measured joint state.", "Check the driver."),
    "limit_violated": Meaning(
        "A limit of position, velocity or acceleration is exceeded.", "Slow the trajectory down, or retime it."
    ),
    "busy": Meaning(
        "The service has no room for this request, or for more from this client.",
        "Wait for the running request or goal, or cancel it.",
    ),
    "unavailable": Meaning(
        "Nobody answered, or the service cannot do this now.", "Look at `zarm status`: it shows what runs."
    ),
    "tolerance_violated": Meaning(
        "The robot left its path or missed its goal.", "Find out why; in `fault`, then send `reset`."
    ),
    "driver_stalled": Meaning(
        "The driver reported nothing new or made no progress, so the robot was stopped.",
        "Check the driver, then send `reset`.",
    ),
    "collision_detected": Meaning(
        "The efforts of the joints show that something pushes the robot, so it was stopped.",
        "See what the robot has hit, then send `reset`.",
    ),
    "cancelled": Meaning("A client cancelled it.", "Nothing: somebody asked for it."),
    "internal": Meaning("zarm has a bug.", "Report it with the trace in the log of the service."),
}
"""Every code, for `docs/reference/problems.md`."""


class Problem(Message):
    """Why a request was refused, or why a goal did not succeed.

    `message` says what to do next. `field` is the path of the wrong field in the request (`goal.position.2`), `joint` the joint
    with the problem. `fraction` (0..1) of a line, arc or path can be followed if not all of it.
    """

    code: Code
    message: str
    field: str | None = None
    joint: str | None = None
    fraction: float | None = None


class ZarmError(Exception):
    """Any error that ends as a Problem. Raise a subclass; `from_problem` makes the one a Problem stands for."""

    codes: ClassVar[tuple[Code, ...]] = ()

    def __init__(
        self,
        message: str,
        *,
        code: Code | None = None,
        field: str | None = None,
        joint: str | None = None,
        fraction: float | None = None,
    ) -> None:
        code = code or self.codes[0]
        if code not in self.codes:
            raise TypeError(f"{type(self).__name__} cannot carry the code {code}")
        self.problem = Problem(code=code, message=message, field=field, joint=joint, fraction=fraction)
        super().__init__(message)

    @property
    def code(self) -> Code:
        """The Problem's code."""
        return self.problem.code

    def __str__(self) -> str:
        place = self.problem.field or self.problem.joint
        return f"{self.problem.message} ({place})" if place else self.problem.message


class InvalidRequest(ZarmError):
    """The request cannot be read or breaks a rule; nothing was done."""

    codes = ("invalid_request",)


class PlanningFailed(ZarmError):
    """There is no plan for this request in this scene."""

    codes = ("no_path", "unreachable", "start_in_collision", "goal_in_collision")


class DeadlineExceeded(ZarmError):
    """The request's own deadline passed."""

    codes = ("timeout",)


class ExecutionRefused(ZarmError):
    """A check before motion failed; the robot did not move."""

    codes = ("limit_violated", "stale_plan", "start_state_mismatch", "no_joint_state")


class ExecutionFailed(ZarmError):
    """A check during motion failed; the robot was stopped."""

    codes = ("tolerance_violated", "driver_stalled", "collision_detected")


class Cancelled(ZarmError):
    """Ended because a client asked for it."""

    codes = ("cancelled",)


class Busy(ZarmError):
    """The service has no room for this request now."""

    codes = ("busy",)


class Unavailable(ZarmError):
    """Nobody answered, or the service cannot serve this now."""

    codes = ("unavailable",)


class InternalError(ZarmError):
    """A fault of zarm itself."""

    codes = ("internal",)


_BY_CODE: dict[str, type[ZarmError]] = {code: cls for cls in ZarmError.__subclasses__() for code in cls.codes}
if not set(_BY_CODE) == set(MEANINGS) == set(get_args(Code)):
    raise TypeError("every problem code needs exactly one exception class and one meaning")


def from_problem(problem: Problem) -> ZarmError:
    """The exception that stands for a Problem received from another process."""
    cls = _BY_CODE[problem.code]
    return cls(problem.message, code=problem.code, field=problem.field, joint=problem.joint, fraction=problem.fraction)
