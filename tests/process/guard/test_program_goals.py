"""A program is one goal: planner, servo and executor in their own processes, and what they do to the scene."""

from __future__ import annotations

import numpy as np
import pytest

from support.cell import Cell
from support.harness import PATIENCE, eventually
from support.planner.client import HOME, KEYS, load
from support.planner.second_opinion import link_pose
from support.trajectories import ROBOT
from zarm_contract.messages import (
    Attach,
    Cuboid,
    Detach,
    DetachObject,
    LineGoal,
    Move,
    Offset,
    Plan,
    PlanRequest,
    PoseGoal,
    ProgramRequest,
    Scene,
    SceneEdit,
    Segment,
    Sphere,
)
from zarm_geometry.frames import pose_of

TIP = link_pose(ROBOT, ROBOT.descriptor.tip_link, HOME)


def at(*shift: float) -> tuple[float, float, float]:
    x, y, z = (TIP[:3, 3] + shift).tolist()
    return x, y, z


def to_pose(*shift: float, name: str | None = None) -> Move:
    goal = PoseGoal(kind="pose", position=at(*shift), orientation=pose_of(TIP).orientation)
    return Move(kind="move", goal=goal, name=name)


def line(*shift: float, speed: float | None = None) -> Move:
    return Move(kind="move", goal=LineGoal(kind="line", position=at(*shift), speed=speed))


def program(cell: Cell, *segments: Segment) -> Plan:
    return cell.bus.call(KEYS.program, ProgramRequest(segments=segments), timeout=PATIENCE)


def scene(cell: Cell) -> Scene:
    return cell.bus.read(KEYS.scene, timeout=PATIENCE)


def test_a_program_is_one_goal_and_edits_the_scene_on_its_way(cell: Cell) -> None:
    part = Cuboid(kind="cuboid", name="part", position=at(0.0, 0.1, -0.2), size=(0.04, 0.04, 0.2))
    load(cell.bus, part)
    made = program(
        cell,
        to_pose(0.0, 0.1, -0.08, name="above"),
        Attach(kind="attach", object="part", touch_links=("link_6",)),
        line(0.0, 0.1, 0.0),
        to_pose(0.0, -0.1, 0.0),
        Detach(kind="detach", object="part"),
        line(0.0, -0.1, 0.05),
    )
    goal = cell.client.execute(plan_id=made.plan_id)
    eventually(lambda: [one.object.name for one in scene(cell).attached] == ["part"], "the part is attached")
    assert cell.client.ended(goal).status == "succeeded"
    left = scene(cell)
    assert left.attached == ()
    (dropped,) = left.objects
    assert dropped.position == pytest.approx(at(0.0, -0.1, -0.12), abs=2e-3)
    segments = [state.segment for state in cell.client.goals if state.goal_id == goal and state.segment is not None]
    assert segments == sorted(segments)
    assert {0, 2, 3, 5} <= set(segments)


def test_part_on_a_table_is_touched_and_lifted_off_under_guard(cell: Cell) -> None:
    x, y, z = at(0.0, 0.15, -0.3)
    table = Cuboid(kind="cuboid", name="table", position=(x, y, z - 0.11), size=(0.3, 0.2, 0.02))
    part = Cuboid(kind="cuboid", name="part", position=(x, y, z), size=(0.05, 0.05, 0.2))
    load(cell.bus, table, part)
    down = Offset(distance=0.1, direction=(0.0, 0.0, 1.0), touch=("part",))
    pick = PoseGoal(kind="pose", position=at(0.0, 0.15, -0.2), orientation=pose_of(TIP).orientation, approach=down)
    up = LineGoal(kind="line", position=at(0.0, 0.15, -0.1))
    made = program(
        cell,
        Move(kind="move", goal=pick),
        Attach(kind="attach", object="part", touch_links=("link_6",)),
        Move(kind="move", goal=up, touch=("table",)),
        line(0.0, 0.05, -0.1),
    )
    assert {name for touch in made.touches for name in touch.objects} == {"part", "table"}
    goal = cell.client.execute(plan_id=made.plan_id)
    assert cell.client.ended(goal).status == "succeeded"
    assert not any(state.hold for state in cell.client.goals if state.goal_id == goal)
    assert [one.object.name for one in scene(cell).attached] == ["part"]
    cell.bus.call(KEYS.scene_edit, SceneEdit(edit=DetachObject(op="detach", name="part")), timeout=PATIENCE)


def test_cancelled_program_changes_nothing_more(cell: Cell) -> None:
    part = Cuboid(kind="cuboid", name="part", position=at(0.0, 0.3, -0.2), size=(0.04, 0.04, 0.2))
    load(cell.bus, part)
    made = program(
        cell,
        to_pose(0.0, 0.3, -0.08),
        Attach(kind="attach", object="part", touch_links=("link_6",)),
        line(0.0, 0.3, 0.0),
    )
    goal = cell.client.execute(plan_id=made.plan_id)
    cell.client.under_way(goal, 0.05)
    cell.client.cancel()
    assert cell.client.ended(goal).status == "cancelled"
    assert scene(cell).attached == ()


def test_a_line_is_not_replanned(cell: Cell) -> None:
    request = PlanRequest(start=HOME, goal=LineGoal(kind="line", position=at(0.0, 0.3, 0.0), speed=0.1))
    made = cell.bus.call(KEYS.plan, request, timeout=PATIENCE)
    goal = cell.client.execute(plan_id=made.plan_id, replan=True)
    cell.client.under_way(goal, 0.05)
    load(cell.bus, Sphere(kind="sphere", name="ball", position=at(0.0, 0.28, 0.0), radius=0.05))
    cell.held(goal)
    load(cell.bus)
    assert cell.client.ended(goal).status == "succeeded"
    for state in cell.client.measured:
        tip = link_pose(ROBOT, ROBOT.descriptor.tip_link, state.position)[:3, 3]
        assert np.abs(tip[[0, 2]] - TIP[[0, 2], 3]).max() < 1e-3
