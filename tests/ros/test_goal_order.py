"""Which goal moves the robot where goals preempt, whatever becomes of their threads."""

from __future__ import annotations

from pathlib import Path

import pytest

from support.paths import PROGRAMS
from support.ros.goals import ABORTED, SUCCEEDED, Actions, Robot
from support.ros.stack import KEYS, stack

SLOW = PROGRAMS / "slow_bridge.py"


@pytest.mark.parametrize(
    "names",
    [("execute_trajectory",) * 2, pytest.param(("send_trajectory", "execute_trajectory"), marks=pytest.mark.slow)],
)
def test_the_one_that_was_sent_last_moves_the_robot_where_the_thread_of_the_first_is_slower(
    tmp_path: Path, names: tuple[str, str]
) -> None:
    with stack(tmp_path, bridge=SLOW) as running:
        running.ros.configure(preempt=True)
        Robot(running.bus, KEYS).plan()
        actions = {name: Actions(running.ros.node, name) for name in names}
        first = actions[names[0]].send()
        assert first.accepted
        last = actions[names[1]].send()
        assert last.ended()[0] == SUCCEEDED
        status, result = first.ended()
        assert status == ABORTED
        assert "another goal took the place of this one" in result.message
