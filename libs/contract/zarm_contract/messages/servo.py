"""What the servo says: how far a goal that runs may go."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from zarm_contract._model import ShortMessage
from zarm_contract.errors import Problem
from zarm_contract.messages.executor import Obstruction
from zarm_contract.messages.motion import Name, NonNegative
from zarm_contract.messages.scene import SceneRevision


class Authority(ShortMessage):
    """Up to where the goal `goal_id` may go: the robot rests before the path time `until` (s); left out, it may go to the end.

    `trajectory` is the number of the `GoalTrajectory` that was checked, and `scene_revision` the scene that it was checked in.
    `obstruction` says what ends the authority. Without a goal the message says that the servo is there. It is repeated
    several times a second; the executor takes a servo that is silent for `execution.guard_timeout` to be gone. `sequence`
    increases with every message of one `servo`, an instance of the service.
    """

    servo: Name
    sequence: Annotated[int, Field(ge=1)]
    goal_id: Name | None = None
    trajectory: Annotated[int, Field(ge=1)] = 1
    scene_revision: SceneRevision | None = None
    until: NonNegative | None = None
    obstruction: Obstruction | None = None


class ServoState(ShortMessage):
    """What the servo does, and in which scene. `guarding`: it checks the goal `goal_id`, which may go up to `until` (s), if given.

    `scene_revision` is the scene that it knows, left out before the first. With `scene_lost` the planner is gone or has lost its
    scene; then what was known still counts. `problem` says why it gives no authority. `check` is how long the last check took (s).
    """

    activity: Literal["idle", "guarding"]
    goal_id: Name | None = None
    scene_revision: SceneRevision | None = None
    scene_lost: bool = False
    until: NonNegative | None = None
    obstruction: Obstruction | None = None
    problem: Problem | None = None
    check: NonNegative = 0.0
