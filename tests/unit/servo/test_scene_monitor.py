from __future__ import annotations

import pytest

from zarm_contract.messages import Scene, Sphere
from zarm_servo.world.scene_monitor import EARLY, SCENES_KEPT, SceneMonitor


def ball(name: str, x: float = 1.0) -> Sphere:
    return Sphere(kind="sphere", name=name, position=(x, 0.0, 0.0), radius=0.1)


def scene(edits: int, *objects: Sphere, draw: int = 0) -> Scene:
    return Scene(revision=f"{edits}-{draw:012x}", objects=objects)


@pytest.fixture
def monitor() -> SceneMonitor:
    return SceneMonitor(lambda: None)


def test_it_tells_every_change() -> None:
    calls: list[int] = []
    monitor = SceneMonitor(lambda: calls.append(1))
    monitor.on_scene("", scene(1, ball("a")))
    monitor.on_object(ball("b"), 0.0)
    monitor.on_object(ball("b"), 0.0)  # as it was
    assert len(calls) == 2


def test_an_object_counts_for_a_while_before_its_scene(monitor: SceneMonitor) -> None:
    monitor.on_scene("", scene(1, ball("a")))
    monitor.on_object(ball("b"), 10.0)
    snapshot = monitor.snapshot(10.1)
    assert set(snapshot.objects) == {"a", "b"}
    assert snapshot.revision == scene(1).revision
    assert set(monitor.snapshot(10.1 + EARLY).objects) == {"a"}


def test_a_scene_is_complete_and_the_last_ones_are_kept(monitor: SceneMonitor) -> None:
    for edits in range(SCENES_KEPT + 2):
        monitor.on_scene("", scene(edits, ball(f"ball{edits}")))
    assert set(monitor.snapshot(0.0).objects) == {f"ball{SCENES_KEPT + 1}"}
    assert monitor.at(scene(0).revision, ()) is None
    remembered = monitor.at(scene(SCENES_KEPT).revision, ())
    assert remembered is not None
    assert set(remembered.objects) == {f"ball{SCENES_KEPT}"}


def test_a_new_scene_keeps_what_was_known_until_edited(
    monitor: SceneMonitor,
) -> None:
    monitor.on_scene("", scene(7, ball("a"), ball("b")))
    monitor.on_scene("", scene(0, ball("b", 2.0), draw=1))
    snapshot = monitor.snapshot(0.0)
    assert snapshot.lost
    assert dict(snapshot.objects) == {"a": ball("a"), "b": ball("b", 2.0)}
    monitor.on_scene("", scene(0, ball("b", 2.0), draw=1))  # told again, as after a link was cut
    assert monitor.snapshot(0.0) == snapshot
    monitor.on_scene("", scene(1, ball("c"), draw=2))
    assert not monitor.snapshot(0.0).lost
    assert set(monitor.snapshot(0.0).objects) == {"c"}
