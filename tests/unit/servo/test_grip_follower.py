"""The gripper of a chunk ends where the chunk says, however slowly the executor answers."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace
from typing import Any

from support.harness import eventually
from zarm_contract.errors import Busy, Problem
from zarm_contract.messages import GripperRequest
from zarm_servo.tracking.grip_follower import GripFollower


def opening(width: float) -> Any:
    """A chunk with this opening."""
    return SimpleNamespace(gripper="hand", opening=lambda _: width)


def test_the_last_opening_is_sent_after_the_answer() -> None:
    answered, sent = threading.Event(), list[float | None]()

    def move(request: GripperRequest) -> None:
        sent.append(request.width)
        answered.wait()

    with ThreadPoolExecutor(1) as pool:
        follower = GripFollower(move, pool, lambda _: None)
        follower.follow(opening(0.08), 0.0)
        eventually(lambda: sent, "the first is under way")
        for width in (0.06, 0.04, 0.02):
            follower.follow(opening(width), 0.0)
        answered.set()
        eventually(lambda: len(sent) > 1, "another is sent")
    assert sent == [0.08, 0.02]


def test_a_refusal_is_told_once_and_the_next_opening_is_sent() -> None:
    problems, sent = list[Problem](), list[float | None]()

    def move(request: GripperRequest) -> None:
        sent.append(request.width)
        raise Busy("the gripper moves")

    with ThreadPoolExecutor(1) as pool:
        follower = GripFollower(move, pool, problems.append)
        for _ in range(3):
            follower.follow(opening(0.08), 0.0)
        eventually(lambda: problems, "it is told")
        follower.follow(opening(0.0795), 0.0)
        follower.follow(opening(0.05), 0.0)
        eventually(lambda: len(problems) > 1, "so is the next")
    assert sent == [0.08, 0.05]
