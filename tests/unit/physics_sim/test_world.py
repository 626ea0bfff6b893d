"""Worlds: those that come with zarm stand, belts run, walkers walk, and a fault in a file is named with its line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import (
    Capsule,
    Conveyor,
    Cuboid,
    DynamicObject,
    LoadWorld,
    MovingObjects,
    Sphere,
)
from zarm_contract.robot import load_robot
from zarm_contract.world import WORLDS, load_world
from zarm_physics_sim.simulation import STEP, Simulation
from zarm_physics_sim.world import World

UR5E = load_robot("ur5e")
HOME = np.array(UR5E.descriptor.home)
NAMES = sorted(path.stem for path in WORLDS.glob("*.yaml"))
BELT = Cuboid(kind="cuboid", name="belt", position=(0.6, 0.7, 0.05), size=(2.0, 0.3, 0.1))
PARCEL = Cuboid(kind="cuboid", name="parcel", position=(0.0, 0.7, 0.125), size=(0.05, 0.05, 0.05))
VISITOR = Capsule(kind="capsule", name="visitor", position=(2.0, 0.0, 0.8), radius=0.2, length=1.0)


def after(simulation: Simulation, seconds: float) -> dict[str, np.ndarray]:
    """Where things are after so many seconds, the robot held where it is."""
    for _ in range(round(seconds / STEP)):
        simulation.step(simulation.bias, np.zeros(len(simulation.fingers)))
    return {name: position for name, (position, _) in simulation.poses().items()}


def test_there_are_seven() -> None:
    assert NAMES == ["bin", "blocks", "board", "conveyor", "person", "shelf", "two_arms"]


@pytest.mark.parametrize("name", NAMES)
def test_what_stands_in_a_world_stays_there(name: str) -> None:
    world = World.of(load_world(name))
    simulation = Simulation(UR5E, world, HOME)
    places = after(simulation, 1.0)
    assert world.dynamic or world.walks or world.textures
    for thing in world.dynamic:
        way = places[thing] - world.objects[thing].position
        assert np.linalg.norm(way[:2]) < 0.005 or world.belts
        assert abs(way[2]) < 0.005


def test_a_belt_takes_along_what_lies_on_it() -> None:
    world = LoadWorld(
        objects=(BELT, PARCEL),
        dynamic=(DynamicObject(name="parcel", mass=0.2),),
        conveyors=(Conveyor(name="belt", speed=0.1),),
    )
    places = after(Simulation(UR5E, World.of(world), HOME), 2.0)
    assert places["parcel"] == pytest.approx((0.2, 0.7, 0.125), abs=0.01)


@pytest.mark.parametrize(("once", "seconds", "x"), [(False, 1.0, 1.5), (False, 3.0, 1.5), (True, 3.0, 1.0)])
def test_a_walker_goes_there_and_back_or_stays(once: bool, seconds: float, x: float) -> None:
    path = ((0.0, 0.0, 0.0), (-1.0, 0.0, 0.0))
    walk = MovingObjects(names=("visitor",), path=path, speed=0.5, once=once)
    places = after(Simulation(UR5E, World.of(LoadWorld(objects=(VISITOR,), moving=(walk,))), HOME), seconds)
    assert places["visitor"] == pytest.approx((x, 0.0, 0.8), abs=0.002)


def test_a_new_world_begins_as_described_and_the_robot_goes_on() -> None:
    dynamic = (DynamicObject(name="parcel", mass=0.2),)
    first = LoadWorld(objects=(BELT, PARCEL), dynamic=dynamic, conveyors=(Conveyor(name="belt", speed=0.1),))
    before = Simulation(UR5E, World.of(first), HOME)
    after(before, 1.0)
    assert before.in_world(before.world.of_scene([VISITOR]), ()) is before, "what the scene says changes nothing"
    assert before.poses()["parcel"][0][0] == pytest.approx(0.1, abs=0.01)
    again = before.in_world(World.of(first), ())
    again.go_on_from(before)
    assert again.poses()["parcel"][0][0] == 0.0
    np.testing.assert_allclose(again.position, before.position)
    assert again.time == before.time


def test_added_things_fall_and_the_others_stay() -> None:
    first = LoadWorld(objects=(BELT, PARCEL), dynamic=(DynamicObject(name="parcel", mass=0.2),), floor=0.0)
    before = Simulation(
        UR5E, World.of(first.model_copy(update={"conveyors": (Conveyor(name="belt", speed=0.1),)})), HOME
    )
    moved = after(before, 1.0)["parcel"]
    ball = Sphere(kind="sphere", name="ball", position=(-0.8, 0.0, 1.0), radius=0.05)
    more = LoadWorld(objects=(ball,), dynamic=(DynamicObject(name="ball", mass=0.1),), add=True)
    again = before.in_world(before.world.joined(World.of(more)), ())
    again.go_on_from(before)
    np.testing.assert_allclose(again.poses()["parcel"][0], moved)
    assert after(again, 0.2)["ball"][2] == pytest.approx(1.0 - 0.5 * 9.81 * 0.2**2, abs=0.01)
    assert after(again, 1.0)["ball"][2] == pytest.approx(0.05, abs=0.005)
    with pytest.raises(InvalidRequest, match="parcel: in the world already; choose another name"):
        before.world.joined(World.of(first))


OBJECTS = "objects:\n  - {kind: sphere, name: ball, position: [1, 0, 0], radius: 0.1}\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (OBJECTS + "dynamic:\n  bal: {mass: 1}\n", "world.yaml:4: dynamic.bal: no object is named bal; there are ball"),
        (OBJECTS + "dynamic:\n  ball: {mass: 0}\n", "world.yaml:4: dynamic.ball.mass: "),
        (OBJECTS + "dynamic:\n  ball: {mass: 1}\nconveyors:\n  ball: {speed: 1}\n", "world.yaml:6: conveyors.ball: "),
        (
            OBJECTS + "moving:\n  - {objects: [bat], path: [[0, 0, 0], [1, 0, 0]], speed: 1}\n",
            "world.yaml:4: moving.0",
        ),
        (OBJECTS + "moving:\n  - {objects: [ball], path: [[0, 0, 0]], speed: 1}\n", "world.yaml:4: moving.0.path: "),
        (OBJECTS + "flor: 0\n", "world.yaml:3: flor: "),
        ("objects:\n  - {kind: sphere, name: ball, position: [1, 0], radius: 0.1}\n", "world.yaml:2: "),
        (OBJECTS + OBJECTS.split("\n", 1)[1], "two objects have the same name"),
    ],
)
def test_a_fault_in_a_file_is_named_with_its_line(text: str, words: str, tmp_path: Path) -> None:
    file = tmp_path / "world.yaml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(InvalidRequest) as caught:
        load_world(str(file))
    assert words in str(caught.value)


def test_an_unknown_world_is_refused_with_those_there_are() -> None:
    with pytest.raises(
        InvalidRequest, match="unknown world 'bn': zarm brings bin, blocks, board, conveyor, person, shelf, two_arms"
    ):
        load_world("bn")


def test_a_picture_that_cannot_be_shown_is_refused_with_its_line(tmp_path: Path) -> None:
    (tmp_path / "words.png").write_text("no picture")
    lines = (WORLDS / "board.yaml").read_text().splitlines()
    for picture, words in (
        ("board: none.png", "world.yaml:6: textures.board: .*none.png: No such file"),
        ("board: words.png", "world.yaml:6: textures.board: .*words.png is not a PNG file"),
        (f"floor: {WORLDS / 'board.png'}", "world.yaml:6: textures.floor: no cuboid is named floor; there are board"),
    ):
        file = tmp_path / "world.yaml"
        file.write_text("\n".join([*lines[:-1], f"  {picture}"]))
        with pytest.raises(InvalidRequest, match=words):
            load_world(str(file))


def test_what_does_not_fit_together_on_the_bus_is_named_by_field() -> None:
    with pytest.raises(InvalidRequest) as caught:
        World.of(LoadWorld(objects=(BELT,), dynamic=(DynamicObject(name="parcel", mass=1.0),)))
    assert caught.value.problem.field == "dynamic.0"
