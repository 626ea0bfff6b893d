"""What a service says in keys of the bus reaches a client on ROS in names of ROS."""

from __future__ import annotations

import pytest

from zarm_contract.errors import Unavailable
from zarm_contract.keys import Keys
from zarm_contract.robot import load_robot
from zarm_ros_bridge.terms import Terms, Translated

TERMS = Terms("/left/unified_planner", Keys("left"), load_robot("doosan_m1013").descriptor.strategy_params)


@pytest.mark.parametrize(
    ("said", "reported"),
    [
        (
            "check its driver, then reset (executor/reset)",
            "check its driver, then reset (/left/unified_planner/reset_fault)",
        ),
        ("plan first (planner/plan), or wait", "plan first (/left/unified_planner/generate_trajectory), or wait"),
        (
            "no driver publishes the robot's joints on zarm/left/driver/joint_states; start the robot's driver",
            "no driver publishes the robot's joints on /dsr01/joint_states; start the robot's driver",
        ),
        (
            "nobody answered on zarm/left/executor/strategy; `zarm status` shows which services run",
            "the executor of left has not answered; `zarm status` shows which services run",
        ),
        (
            "nobody answered on zarm/left/scene/edit within 5 s; `zarm status` shows which services run",
            "the planner of left has not answered within 5 s; `zarm status` shows which services run",
        ),
        ("the goal breaks the path constraint: there", "the goal breaks trajectory_constraints: there"),
        (
            "there is already an object box; remove it first, set replace, or choose another name",
            "there is already an object box; remove it first, or choose another name",
        ),
        (
            "the file executor/resets and zarm/right/driver/command",
            "the file executor/resets and zarm/right/driver/command",
        ),
    ],
)
def test_a_key_with_a_ros_name_is_translated(said: str, reported: str) -> None:
    assert TERMS.of(said) == reported

    def refuse() -> None:
        raise Unavailable(said, field="start")

    with pytest.raises(Unavailable) as refused:
        Translated(TERMS).run_interruptibly(refuse)
    assert (refused.value.problem.message, refused.value.problem.field) == (reported, "start")
