"""Which goal moves the robot where goals preempt, whatever becomes of their threads."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from support.paths import PROGRAMS
from support.ros.goals import ABORTED, SUCCEEDED, Actions, Robot
from support.ros.stack import KEYS, Stack, stack

pytestmark = pytest.mark.slow

SLOW = PROGRAMS / "slow_bridge.py"


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    with stack(tmp_path_factory.mktemp("order"), bridge=SLOW) as started:
        started.ros.configure(preempt=True)
        yield started


@pytest.mark.parametrize("names", [("execute_trajectory",) * 2, ("send_trajectory", "execute_trajectory")])
def test_the_goal_sent_last_wins_over_a_slow_thread(running: Stack, names: tuple[str, str]) -> None:
    Robot(running.bus, KEYS).plan()
    actions = {name: Actions(running.ros.node, name) for name in names}
    first = actions[names[0]].send()
    assert first.accepted
    last = actions[names[1]].send()
    assert last.ended()[0] == SUCCEEDED
    status, result = first.ended()
    assert status == ABORTED
    assert "another goal took the place of this one" in result.message
