from __future__ import annotations

import pytest

from zarm_contract.messages import Scene, Sphere
from zarm_servo.world import EARLY, REMEMBERED, Mirror


def ball(name: str, x: float = 1.0) -> Sphere:
    return Sphere(kind="sphere", name=name, position=(x, 0.0, 0.0), radius=0.1)


def scene(edits: int, *objects: Sphere, draw: int = 0) -> Scene:
    return Scene(revision=f"{edits}-{draw:012x}", objects=objects)


@pytest.fixture
def mirror() -> Mirror:
    return Mirror(lambda: None)


def test_it_tells_every_change() -> None:
    calls: list[int] = []
    mirror = Mirror(lambda: calls.append(1))
    mirror.hear_scene("", scene(1, ball("a")))
    mirror.hear_object(ball("b"), 0.0)
    mirror.hear_object(ball("b"), 0.0)  # as it was
    assert len(calls) == 2


def test_an_object_counts_before_its_scene_has_come_and_not_for_long_where_none_comes(mirror: Mirror) -> None:
    mirror.hear_scene("", scene(1, ball("a")))
    mirror.hear_object(ball("b"), 10.0)
    seen = mirror.seen(10.1)
    assert set(seen.objects) == {"a", "b"}
    assert seen.revision == scene(1).revision
    assert set(mirror.seen(10.1 + EARLY).objects) == {"a"}


def test_a_scene_is_all_there_is_and_the_last_ones_are_remembered(mirror: Mirror) -> None:
    for edits in range(REMEMBERED + 2):
        mirror.hear_scene("", scene(edits, ball(f"ball{edits}")))
    assert set(mirror.seen(0.0).objects) == {f"ball{REMEMBERED + 1}"}
    assert mirror.at(scene(0).revision) is None
    remembered = mirror.at(scene(REMEMBERED).revision)
    assert remembered is not None
    assert set(remembered.objects) == {f"ball{REMEMBERED}"}


def test_what_was_known_still_counts_where_the_planner_begins_another_scene_until_that_is_edited(
    mirror: Mirror,
) -> None:
    mirror.hear_scene("", scene(7, ball("a"), ball("b")))
    mirror.hear_scene("", scene(0, ball("b", 2.0), draw=1))
    seen = mirror.seen(0.0)
    assert seen.lost
    assert dict(seen.objects) == {"a": ball("a"), "b": ball("b", 2.0)}
    mirror.hear_scene("", scene(0, ball("b", 2.0), draw=1))  # told again, as after a link was cut
    assert mirror.seen(0.0) == seen
    mirror.hear_scene("", scene(1, ball("c"), draw=2))
    assert not mirror.seen(0.0).lost
    assert set(mirror.seen(0.0).objects) == {"c"}
