"""What the robot carries, over the bus: attached and detached where the robot is measured, planned with, published, kept."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from support.harness import PATIENCE, ServiceProcess, eventually
from support.planner.client import HOME, KEYS, ROBOT
from support.planner.second_opinion import Collisions, link_pose
from zarm_contract.errors import ExecutionRefused, InvalidRequest, PlanningFailed, Unavailable
from zarm_contract.key import Latched
from zarm_contract.messages import (
    AddObjects,
    AttachObject,
    Capsule,
    CheckRequest,
    Cuboid,
    DetachObject,
    IkRequest,
    JointGoal,
    JointState,
    LoadScene,
    Plan,
    PlanRequest,
    Pose,
    Scene,
    SceneEdit,
    SceneEdited,
    SceneObject,
    SetLinkCollision,
)
from zarm_executor.checks import executable
from zarm_runtime.bus import Bus

SWUNG = (1.2, *HOME[1:])

TIP = link_pose(ROBOT, ROBOT.descriptor.tip_link, HOME)
X, Y, Z = TIP[:3, 3].tolist()
POLE_KEY = Latched("scene/object/pole", Capsule, "The pole.", of="planner").of_robot(KEYS.robot)
POLE = Capsule(kind="capsule", name="pole", position=(X, Y, Z - 0.25), radius=0.02, length=0.3)
"""Hangs down from the tip at HOME."""


def wall() -> Cuboid:
    """Half-way from HOME to SWUNG, so low that the bare robot passes above it."""
    x, y, _ = link_pose(ROBOT, ROBOT.descriptor.tip_link, (0.6, *HOME[1:]))[:3, 3].tolist()
    return Cuboid(kind="cuboid", name="wall", position=(x, y, (Z - 0.2) / 2), size=(0.1, 0.1, Z - 0.2))


def edit(bus: Bus, what: AddObjects | AttachObject | DetachObject | LoadScene | SetLinkCollision) -> SceneEdited:
    return bus.call(KEYS.scene_edit, SceneEdit(edit=what), timeout=PATIENCE)


def begin(bus: Bus, *objects: SceneObject) -> SceneEdited:
    """A scene in which nothing is carried and all links are looked at."""
    for carried in scene(bus).attached:
        edit(bus, DetachObject(op="detach", name=carried.object.name, joints=HOME))
    edit(bus, SetLinkCollision(op="links", names=tuple(ROBOT.descriptor.spheres), enabled=True))
    return edit(bus, LoadScene(op="load", objects=objects))


def scene(bus: Bus) -> Scene:
    return bus.read(KEYS.scene, timeout=PATIENCE)


def attach(bus: Bus, name: str) -> SceneEdited:
    return edit(bus, AttachObject(op="attach", name=name, joints=HOME))


def plan(bus: Bus, request: PlanRequest) -> Plan:
    return bus.call(KEYS.plan, request, timeout=PATIENCE)


def swing(bus: Bus, goal: tuple[float, ...] = SWUNG) -> Plan:
    return plan(bus, PlanRequest(start=HOME, goal=JointGoal(kind="joints", position=goal)))


def hits(plan: Plan, now: Scene) -> bool:
    path = executable(plan.trajectory, ROBOT)
    collisions = Collisions(ROBOT, now.objects, now.attached, now.ignored_links)
    return any(collisions.at(path.at(t)[0]) for t in np.linspace(0.0, path.duration, int(path.duration / 0.004) + 2))


def test_a_carried_object_is_led_around_obstacles(planner: Bus) -> None:
    begin(planner, POLE, wall())
    edited = attach(planner, "pole")
    loaded = scene(planner)
    assert [one.object.name for one in loaded.attached] == ["pole"]
    with_pole = swing(planner)
    assert with_pole.scene_revision == edited.revision
    assert not hits(with_pole, loaded)
    begin(planner, wall())
    bare = swing(planner)
    assert not hits(bare, scene(planner))
    assert hits(bare, loaded)


def test_disabled_links_are_not_checked(planner: Bus) -> None:
    begin(planner, POLE.model_copy(update={"radius": 0.1}))
    with pytest.raises(PlanningFailed, match="start is in collision"):
        swing(planner)
    (hit,) = planner.call(KEYS.check, CheckRequest(joints=(HOME,)), timeout=PATIENCE).results
    assert hit.pair is not None
    edit(planner, SetLinkCollision(op="links", names=("link_5", "link_6"), enabled=False))
    (free,) = planner.call(KEYS.check, CheckRequest(joints=(HOME,)), timeout=PATIENCE).results
    assert not free.in_collision
    assert not hits(swing(planner), scene(planner))


def test_a_goal_in_collision_with_the_carried_object_names_it(planner: Bus) -> None:
    begin(planner, POLE, wall())
    attach(planner, "pole")
    with pytest.raises(PlanningFailed, match=r"pole is \d+\.\d mm inside wall") as refused:
        swing(planner, (0.6, *HOME[1:]))
    assert refused.value.code == "goal_in_collision"
    there = link_pose(ROBOT, ROBOT.descriptor.tip_link, (0.6, *HOME[1:]))[:3, 3].tolist()
    request = IkRequest(poses=(Pose(position=tuple(there), orientation=(1.0, 0.0, 0.0, 0.0)),), near=HOME)
    assert planner.call(KEYS.ik, request, timeout=PATIENCE).solutions == ((),)


def test_attach_and_detach_use_the_measured_joints(planner: Bus) -> None:
    begin(planner, POLE)
    attached, detached = AttachObject(op="attach", name="pole"), DetachObject(op="detach", name="pole")
    with pytest.raises(ExecutionRefused) as refused:
        edit(planner, attached)
    assert refused.value.code == "no_joint_state"
    states = planner.publisher(KEYS.joint_states)

    def where_measured(q: tuple[float, ...], what: AttachObject | DetachObject) -> SceneEdited:
        state = JointState(stamp=0.0, joint_names=ROBOT.descriptor.joints, position=q, velocity=(0.0,) * 6)

        def arrived() -> bool:
            states.put(state)
            try:
                return plan(planner, PlanRequest(goal=JointGoal(kind="joints", position=q))).path_length == 0.0
            except ExecutionRefused:
                return False

        eventually(arrived, "the planner has received the measured state")
        states.put(state)
        return edit(planner, what)

    where_measured(HOME, attached)
    assert scene(planner).objects == ()
    where_measured(SWUNG, detached)
    turned = link_pose(ROBOT, ROBOT.descriptor.tip_link, SWUNG) @ np.linalg.inv(TIP)
    (pole,) = scene(planner).objects
    np.testing.assert_allclose(pole.position, (turned @ [*POLE.position, 1.0])[:3], atol=1e-9)


def test_a_carried_object_leaves_the_scene_until_detached(planner: Bus) -> None:
    begin(planner, POLE)
    seen: list[Scene] = []
    planner.watch(KEYS.scene, lambda _, message: seen.append(message))
    assert attach(planner, "pole").count == 0
    carried = eventually(
        lambda: [one for one in seen if one.attached], "the scene with its carried object is published"
    )
    assert (carried[0].objects, carried[0].attached[0].object.name) == ((), "pole")
    with pytest.raises(Unavailable):
        planner.read(POLE_KEY, timeout=PATIENCE)
    with pytest.raises(InvalidRequest, match="detach it first"):
        edit(planner, AddObjects(op="add", objects=(POLE,)))
    assert edit(planner, DetachObject(op="detach", name="pole", joints=HOME)).count == 1
    put_down = planner.read(POLE_KEY, timeout=PATIENCE)
    np.testing.assert_allclose(put_down.position, POLE.position, atol=1e-9)


def test_what_is_carried_survives_a_crash(endpoint: str, bus: Bus, tmp_path: Path) -> None:
    with ServiceProcess("planner", endpoint, tmp_path) as first:
        first.wait_ready(bus, KEYS)
        begin(bus, POLE, wall())
        attach(bus, "pole")
        before = scene(bus)
        first.kill()
    with Bus(endpoint) as fresh, ServiceProcess("planner", endpoint, tmp_path) as second:
        second.wait_ready(fresh, KEYS)
        assert scene(fresh) == before
        assert not hits(swing(fresh), before)


def test_a_check_tells_the_distance_of_each_collision_sphere(planner: Bus) -> None:
    begin(planner, wall())
    request = CheckRequest(joints=(HOME, (0.6, *HOME[1:])), spheres=True)
    home, above = planner.call(KEYS.check, request, timeout=PATIENCE).results
    assert home.spheres is not None
    assert above.spheres is not None
    count = sum(len(balls) for balls in ROBOT.descriptor.spheres.values())
    assert len(home.spheres) == len(above.spheres) == count
    assert 0.0 < min(above.spheres) < 0.2 < min(home.spheres)
    without = request.model_copy(update={"spheres": False})
    assert planner.call(KEYS.check, without, timeout=PATIENCE).results[0].spheres is None
