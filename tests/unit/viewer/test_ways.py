"""The ways that are chosen on the page become one goal, or the segments of a program."""

from __future__ import annotations

import pytest

from zarm.motions import Arc, Line, Path, PoseGoal, Waypoints
from zarm.values import Pose
from zarm_contract.errors import InvalidRequest
from zarm_viewer.way_options import MIDDLE, QUICKEST, STRAIGHT, Passed, Way

A, B, C = Pose((0.4, 0.0, 0.3)), Pose((0.5, 0.1, 0.3)), Pose((0.4, 0.2, 0.3))


def way(to_goal: str, *free: str) -> Way:
    return Way(to_goal, free, 0.1, 0.03)  # type: ignore[arg-type]


def test_one_way_to_all_poses_is_one_goal() -> None:
    assert way(QUICKEST).target([], C) == C
    assert way(QUICKEST).target([Passed(A, QUICKEST)], C) == Waypoints(A, C)
    assert way(QUICKEST, "theta_z").target([], C) == PoseGoal(C, free=("theta_z",))
    assert way(STRAIGHT).target([], C) == Line(C, speed=0.1)
    assert way(STRAIGHT).target([Passed(A, STRAIGHT)], C) == Path(A, C, speed=0.1)


def test_different_ways_are_segments_that_blend_with_their_like() -> None:
    passed = [Passed(A, QUICKEST), Passed(B, STRAIGHT), Passed(A, MIDDLE)]
    assert way(STRAIGHT).target(passed, C) is None
    segments = way(STRAIGHT).segments(passed, C, "left")
    assert [segment.goal.kind for segment in segments] == ["pose", "line", "arc"]
    assert [segment.blend for segment in segments] == [0.0, 0.03, 0.0]
    assert {segment.group for segment in segments} == {"left"}
    arc = segments[2].goal
    assert isinstance(arc, Arc)
    assert (arc.position, arc.via, arc.speed) == (C.position, A.position, 0.1)


def test_an_arc_with_two_middles_is_refused() -> None:
    with pytest.raises(InvalidRequest, match="an arc has one middle"):
        way(QUICKEST).segments([Passed(A, MIDDLE), Passed(B, MIDDLE)], C, None)
