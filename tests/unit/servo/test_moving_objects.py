"""Poses of moving objects: which are taken, what they mean, and what becomes of an object that nothing is told of any more."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from zarm_contract.messages import Cuboid, Mesh, ObjectPose, Scene, SceneObject, Sphere, Voxels
from zarm_geometry.meshes import Meshes
from zarm_servo.world.moving_objects import AGREE, LOST, MovingObjects
from zarm_servo.world.scene_monitor import SceneMonitor

NOW, WALL = 50.0, 1.75e9
BOX = Cuboid(kind="cuboid", name="box", position=(1.0, 0.0, 0.0), size=(0.2, 0.2, 0.2))
BALL = Sphere(kind="sphere", name="ball", position=(0.0, 1.0, 0.0), radius=0.1)
CELLS = Voxels(kind="voxels", name="cells", resolution=0.1, cells=((0, 0, 0),))


class Told:
    """Moving objects in a scene, and what is told of them."""

    def __init__(self) -> None:
        self.monitor = SceneMonitor(lambda: None)
        self.edits = 0
        self.changes = 0
        self.scene(BOX, BALL, CELLS)
        self.moving = MovingObjects(self.monitor, Meshes(), self._changed)

    def _changed(self) -> None:
        self.changes += 1

    def scene(self, *objects: SceneObject) -> None:
        self.edits += 1
        self.monitor.on_scene("", Scene(revision=f"{self.edits}-5be0c1d2f3a4", objects=objects))

    def update_object(self, name: str = "box", *, late: float = 0.01, now: float = NOW, **fields: Any) -> str | None:
        """Tell a pose that was made `late` s ago; the field for which it is refused."""
        known = {"stamp": WALL + now - late, "position": (0.5, 0.0, 0.0), "speed": 0.2}
        message = ObjectPose.model_construct(**(known | fields))
        self.moving.update_object(name, message.model_dump_json().encode(), now, WALL + now)
        return None if self.moving.refused is None else self.moving.refused.field

    def all(self) -> dict[str, Any]:
        return {mover.item.name: mover for mover in self.moving.of(self.monitor.snapshot(NOW))}


@pytest.fixture
def reported() -> Told:
    return Told()


def test_an_object_moves_on_from_when_it_was_seen(reported: Told) -> None:
    assert reported.update_object(linear=(0.1, 0.0, 0.0)) is None
    mover = reported.all()["box"]
    assert mover.placed == BOX.model_copy(update={"position": (0.5, 0.0, 0.0)})
    moving = mover.moving(NOW, ahead=0.06)
    assert (moving.velocity, moving.speed) == ((0.1, 0.0, 0.0), 0.2)
    assert moving.time == pytest.approx(-(0.01 + AGREE + 0.06))
    assert reported.changes == 1


def test_a_turning_object_is_as_fast_as_its_farthest_point(reported: Told) -> None:
    reported.update_object(angular=(0.0, 0.0, 2.0), speed=0.0)
    assert reported.all()["box"].speed == pytest.approx(2.0 * 0.1 * np.sqrt(3))
    reported.update_object("ball", angular=(0.0, 0.0, 2.0), speed=0.0)
    assert reported.all()["ball"].speed == 0.0


@pytest.mark.parametrize(("fast", "apart"), [(0.4, 0.021), (60.0, 0.31)])
def test_one_of_a_few_places_is_near_wherever_it_can_be(reported: Told, fast: float, apart: float) -> None:
    reported.update_object(linear=(fast, 0.0, 0.0), speed=0.1)
    mover, rng = reported.all()["box"], np.random.default_rng(0)
    places = mover.swept(NOW, 0.5, 0.02)
    assert len(places) <= 50
    for time in rng.uniform(0.0, 0.5, 200):
        age, way = mover.age(NOW) + time, rng.normal(size=3)
        there = np.array((0.5, 0.0, 0.0)) + age * (np.array((fast, 0.0, 0.0)) + 0.1 * way / np.linalg.norm(way))
        assert any(np.linalg.norm(there - each.object.position - each.offset) <= each.growth + 1e-9 for each in places)
    assert max(each.growth for each in places) < 0.1 * 0.55 + apart


@pytest.mark.parametrize(
    ("field", "value"),
    [("position", (0.0, 1e300, 0.0)), ("linear", (-1e6, 0.0, 0.0)), ("angular", (0.0, 0.0, 1e4)), ("speed", 1e300)],
)
def test_too_far_or_too_fast_is_refused_by_field(reported: Told, field: str, value: Any) -> None:
    assert reported.update_object() is None
    assert reported.update_object(late=0.005, **{field: value}) == field
    assert reported.all()["box"].placed.position == (0.5, 0.0, 0.0)


def test_the_newest_counts_whatever_comes_later(reported: Told) -> None:
    reported.update_object(late=0.01)
    assert reported.update_object(late=0.05, position=(0.9, 0.0, 0.0)) is None
    assert reported.all()["box"].placed.position == (0.5, 0.0, 0.0)


@pytest.mark.parametrize(
    ("name", "fields", "field"),
    [
        ("chair", {}, "name"),
        ("cells", {}, "name"),
        ("box", {"late": -0.5}, "stamp"),
        ("box", {"late": 2.0}, "stamp"),
        ("box", {"speed": -1.0}, "speed"),
        ("box", {"position": (float("nan"), 0.0, 0.0)}, "position.0"),
    ],
)
def test_an_invalid_update_is_refused_by_field(reported: Told, name: str, fields: dict[str, Any], field: str) -> None:
    reported.update_object()
    before = reported.all()
    assert reported.update_object(name, **fields) == field
    assert reported.all() == before
    assert reported.update_object(late=0.0) == field  # it is told for a second
    assert reported.all()["box"].stamp > before["box"].stamp
    assert reported.update_object(late=0.0, now=NOW + 1.1) is None


def test_an_object_without_updates_grows_and_is_lost(reported: Told) -> None:
    reported.update_object(late=0.0)
    mover = reported.all()["box"]
    assert mover.age(NOW + 0.5) == pytest.approx(0.5 + AGREE)
    assert reported.moving.lost(NOW + 0.5) == ()
    assert mover.age(NOW + 60.0) == LOST
    assert reported.moving.lost(NOW + 60.0) == ("box",)
    assert reported.all()["box"] is mover


def test_an_edit_of_an_object_places_it_anew(reported: Told) -> None:
    reported.update_object()
    reported.scene(BOX.model_copy(), CELLS)
    assert "box" in reported.all()
    reported.scene(BOX.model_copy(update={"size": (0.1, 0.1, 0.1)}), CELLS)
    assert reported.all() == {}


def test_a_mesh_that_is_not_there_is_refused(reported: Told) -> None:
    reported.scene(Mesh(kind="mesh", name="part", position=(0.0, 0.0, 0.0), file="part.stl", sha256="0" * 64))
    reported.update_object("part")
    assert reported.moving.refused is not None
    assert reported.moving.refused.code == "unavailable"
