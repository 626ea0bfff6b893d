"""Translates messages of zarm's services from bus keys to names that a ROS client knows."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import TypeVar

from zarm.interrupts import CtrlC
from zarm_contract.descriptor import StrategyParams
from zarm_contract.errors import ZarmError, from_problem
from zarm_contract.keys import Keys

T = TypeVar("T")

_FIELDS = {
    ", set replace,": ",",  # add_object has no such field
    ", see goal.tolerance": "",  # goals of curobo_ros have none, those of MoveIt have it elsewhere
    "breaks the path constraint": "breaks trajectory_constraints",
}
_SILENT = re.compile(r"nobody answered on zarm/\w+/(\w+)[\w/.*-]*")


class Terms:
    """Names under `node` (`/unified_planner`) and topics of the driver that `params` describes, instead of the keys of the robot."""

    def __init__(self, node: str, keys: Keys, params: StrategyParams | None) -> None:
        self._keys = keys
        own = f"{node}/"
        names: dict[str, str] = {
            keys.plan: f"{own}generate_trajectory",
            keys.ik: f"{own}ik",
            keys.fk: f"{own}fk",
            keys.check: f"{own}get_collision_distance",
            keys.occupancy: f"{own}get_voxel_grid",
            keys.scene_edit: f"{own}add_object",
            keys.execute: f"{own}execute_trajectory",
            keys.cancel: f"{own}execute_trajectory/_action/cancel_goal",
            keys.reset: f"{own}reset_fault",
            keys.strategy: f"{own}set_robot_strategy",
            keys.executor_state: f"{own}get_robot_strategy",
        }
        if params is not None:
            names |= {
                keys.driver_command: params.command_topic,
                keys.driver_progress: params.state_topic or params.joint_states_topic,
                keys.driver_joint_states: params.joint_states_topic,
            }
        robot = f"zarm/{keys.robot}/"
        self._names = names | {key.removeprefix(robot): name for key, name in names.items()}
        words = "|".join(map(re.escape, sorted(self._names, key=len, reverse=True)))
        self._words = re.compile(rf"(?<![\w/])(?:{words})(?![\w/])")

    def of(self, text: str) -> str:
        """The text with each key replaced by its name on ROS, if it has one."""
        text = _SILENT.sub(self._silent, text)
        for said, reported in _FIELDS.items():
            text = text.replace(said, reported)
        return self._words.sub(lambda found: self._names[found[0]], text)

    def of_error(self, error: ZarmError) -> ZarmError:
        """The same error in these terms."""
        return from_problem(error.problem.model_copy(update={"message": self.of(error.problem.message)}))

    def _silent(self, found: re.Match[str]) -> str:
        service = {"scene": "planner"}.get(found[1], found[1])
        return f"the {service} of {self._keys.robot} has not answered"


class Translated(CtrlC):
    """Calls of a bus client, whose errors are translated into terms of ROS."""

    def __init__(self, terms: Terms) -> None:
        self._terms = terms

    def run_interruptibly(self, work: Callable[[], T]) -> T:
        """See `zarm.interrupts.Interrupts`."""
        try:
            return super().run_interruptibly(work)
        except ZarmError as error:
            raise self._terms.of_error(error) from error
