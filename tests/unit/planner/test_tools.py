"""Tools are mounted and changed at run time: their tips are those of the robot, and their shapes are part of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from support.composed import composed
from support.tools import tooled_panda, tooled_robot, with_tools
from zarm_contract.errors import Busy, InvalidRequest, Unavailable
from zarm_contract.messages import (
    AddObjects,
    AttachObject,
    CheckRequest,
    Cuboid,
    DetachObject,
    FkRequest,
    IkRequest,
    LineGoal,
    MountTool,
    Move,
    Plan,
    PlanRequest,
    Pose,
    PoseGoal,
    ProgramRequest,
    Scene,
    SceneEdit,
    SetObjectCollision,
    UnmountTool,
)
from zarm_contract.robot import load_robot
from zarm_geometry.frames import matrix, pose_of
from zarm_geometry.robot_model import RobotModel
from zarm_planner.handlers import Handlers
from zarm_planner.scene.store import SceneStore
from zarm_planner.scene.tools import Tools

WELDER = matrix((0.05, 0.0, 0.25), (0.0, 0.7071067811865476, 0.0, 0.7071067811865476))
"""Its tip in the frame of the flange."""


class Cell:
    """A planner of the M1013 with tools, at home."""

    def __init__(self, folder: Path) -> None:
        self.robot = tooled_robot(folder)
        self.model = RobotModel.of(self.robot)
        self.home = np.array(self.robot.descriptor.home)
        self.moving = False
        self.folder = folder
        self.planner = self.started()

    def started(self) -> Handlers:
        """Another planner with the saved scene."""
        store = SceneStore(self.folder, None, self.robot.urdf.links, Tools.of(self.robot))
        self.store = store
        return Handlers(self.model, "arm", store, lambda: self.home, moves=lambda: self.moving)

    def edit(self, edit: object) -> Scene:
        return self.planner.edit(SceneEdit.model_validate({"edit": edit}))

    def mount(self, tool: str) -> Scene:
        return self.edit(MountTool(op="mount", tool=tool))

    def unmount(self, tool: str) -> Scene:
        return self.edit(UnmountTool(op="unmount", tool=tool))

    def tip(self, q: np.ndarray | tuple[float, ...]) -> np.ndarray:
        (pose,) = self.planner.fk(FkRequest(joints=(tuple(q),))).poses
        return matrix(pose.position, pose.orientation)

    def flange(self, q: np.ndarray | tuple[float, ...]) -> np.ndarray:
        return self.model.fk_link("link_6", np.array(q))


@pytest.fixture
def cell(tmp_path: Path) -> Cell:
    return Cell(tmp_path)


def test_mounted_tool_has_the_tip_until_it_is_taken_off(cell: Cell) -> None:
    assert cell.tip(cell.home) == pytest.approx(cell.flange(cell.home), abs=1e-12)
    assert cell.mount("welder").tools == ("welder",)
    assert cell.tip(cell.home) == pytest.approx(cell.flange(cell.home) @ WELDER, abs=1e-12)
    assert cell.mount("probe").tools == ("probe",), "it takes the place of the welder"
    assert cell.tip(cell.home)[:3, 3] == pytest.approx((cell.flange(cell.home) @ [0, 0, 0.4, 1])[:3], abs=1e-12)
    assert cell.unmount("probe").attached == ()
    assert cell.tip(cell.home) == pytest.approx(cell.flange(cell.home), abs=1e-12)


def test_poses_lines_and_inverse_kinematics_are_of_the_tool(cell: Cell) -> None:
    cell.mount("welder")
    goal = cell.flange(cell.home) @ WELDER
    goal[:3, 3] += (0.0, 0.1, -0.05)
    pose = pose_of(goal)
    wanted = PoseGoal(kind="pose", position=pose.position, orientation=pose.orientation)
    plan = cell.planner.plan(PlanRequest(goal=wanted))
    last = plan.trajectory.position[-1]
    assert cell.flange(last) @ WELDER == pytest.approx(goal, abs=2e-4)
    assert matrix(plan.tip.position, plan.tip.orientation) == pytest.approx(goal, abs=2e-4)
    (found, *_), *_ = cell.planner.ik(IkRequest(poses=(pose,))).solutions
    assert cell.flange(found) @ WELDER == pytest.approx(goal, abs=2e-4)
    line = LineGoal(kind="line", position=pose.position, orientation=pose.orientation)
    straight = cell.planner.plan(PlanRequest(goal=line))
    points = np.array([(cell.flange(q) @ WELDER)[:3, 3] for q in straight.trajectory.position])
    along = goal[:3, 3] - points[0]
    off = np.cross(points - points[0], along / np.linalg.norm(along))
    assert np.linalg.norm(off, axis=1).max() < 1e-4


def test_program_with_a_mounted_tool_moves_its_tip(cell: Cell) -> None:
    cell.mount("welder")
    begin = pose_of(cell.flange(cell.home) @ WELDER)
    x, y, z = begin.position
    corners = [(x, y + 0.05, z), (x, y + 0.05, z - 0.05)]
    moves = tuple(
        Move(kind="move", goal=LineGoal(kind="line", position=corner, orientation=begin.orientation), blend=blend)
        for corner, blend in zip(corners, (0.01, 0.0), strict=True)
    )
    plan, _ = cell.planner.program(ProgramRequest(segments=moves))
    assert (cell.flange(plan.trajectory.position[-1]) @ WELDER)[:3, 3] == pytest.approx(corners[-1], abs=1e-4)
    assert plan.tip.position == pytest.approx(corners[-1], abs=1e-4)
    passed = np.interp(plan.segments[0].end, plan.trajectory.time, range(len(plan.trajectory.time)))
    corner = cell.flange(plan.trajectory.position[round(passed)]) @ WELDER
    assert np.linalg.norm(corner[:3, 3] - corners[0]) < 0.011


def test_tool_shapes_avoid_obstacles_and_the_robot(cell: Cell) -> None:
    at = (cell.flange(cell.home) @ [0.04, 0.0, 0.24, 1.0])[:3]
    post = Cuboid(kind="cuboid", name="post", position=tuple(at.tolist()), size=(0.02, 0.02, 0.02))
    cell.edit(AddObjects(op="add", objects=(post,)))
    (before,) = cell.planner.check(CheckRequest()).results
    assert not before.in_collision
    cell.mount("welder")
    (result,) = cell.planner.check(CheckRequest()).results
    assert result.in_collision
    assert result.pair == ("welder_2", "post")
    cell.unmount("welder")
    (after,) = cell.planner.check(CheckRequest()).results
    assert not after.in_collision


def test_payload_of_the_tool_counts_in_torques(tmp_path: Path) -> None:
    robot = tooled_panda(tmp_path)
    model = RobotModel.of(robot)
    attached = Tools.of(robot).mount(Scene(revision="0-000000000000"), "welder").attached
    loaded = model.with_attached(attached, ())
    home = np.array(robot.descriptor.home)
    assert model.dynamics is not None
    assert loaded.dynamics is not None
    added = (loaded.dynamics.holding(home[None]) - model.dynamics.holding(home[None]))[0]

    def height(q: np.ndarray) -> float:
        return float((model.fk_tip(q) @ [0.0, 0.0, 0.08, 1.0])[2])

    step = 1e-5
    by_work = [
        2.0 * 9.81 * (height(home + step * unit) - height(home - step * unit)) / (2 * step)
        for unit in np.eye(len(home))
    ]
    assert added == pytest.approx(by_work, abs=1e-3), "the torque is what lifting its centre of mass takes"


def test_tool_survives_a_restart_as_the_descriptor_has_it_now(cell: Cell) -> None:
    cell.mount("welder")
    box = Cuboid(kind="cuboid", name="box", position=(0.6, 0.6, 0.1), size=(0.05, 0.05, 0.05))
    cell.edit(AddObjects(op="add", objects=(box,)))
    cell.edit(AttachObject(op="attach", name="box"))
    before = cell.store.scene
    cell.planner.close()
    cell.planner = cell.started()
    assert cell.store.scene == before
    path = Path(with_tools(cell.folder))
    path.write_text(path.read_text().replace("radius: 0.03", "radius: 0.04"))
    cell.robot = load_robot(str(path))
    cell.model = RobotModel.of(cell.robot)
    cell.started()
    radii = {one.object.name: getattr(one.object, "radius", None) for one in cell.store.scene.attached}
    assert radii == {"box": None, "welder_1": 0.04, "welder_2": 0.01}
    assert cell.store.scene.revision != before.revision, "plans made with the thinner one are not of this scene"
    path.write_text(path.read_text().replace("welder:", "other:"))
    cell.robot = load_robot(str(path))
    with pytest.raises(Unavailable, match=r"tool welder mounted, and .*doosan_m1013.yaml does not describe it"):
        cell.started()


def test_what_cannot_be_is_refused_by_name_and_changes_nothing(cell: Cell) -> None:
    box = Cuboid(kind="cuboid", name="box", position=(0.6, 0.6, 0.1), size=(0.05, 0.05, 0.05))
    cell.edit(AddObjects(op="add", objects=(box, box.model_copy(update={"name": "probe_1"}))))
    cell.mount("welder")
    cell.edit(AttachObject(op="attach", name="box"))
    before = cell.store.scene
    assert before.attached[-1].link == "welder", "what is attached by default hangs on the tip"
    for edit, message, field in (
        (MountTool(op="mount", tool="torch"), "has no tool torch; it has welder, probe", "edit.tool"),
        (MountTool(op="mount", tool="welder"), "welder is mounted already", "edit.tool"),
        (UnmountTool(op="unmount", tool="probe"), "probe is not mounted; mounted: welder", "edit.tool"),
        (UnmountTool(op="unmount", tool="welder"), "welder carries box; detach it first", "edit.tool"),
        (DetachObject(op="detach", name="welder_1"), "welder_1 is a shape of the tool welder", "edit.name"),
        (
            SetObjectCollision(op="objects", names=("box", "welder_2"), enabled=False),
            "welder_2 is a shape of the tool welder",
            "edit.names.1",
        ),
        (
            AddObjects(op="add", objects=(box.model_copy(update={"name": "welder"}),)),
            "welder is a link of the robot",
            "edit.objects.0.name",
        ),
    ):
        with pytest.raises(InvalidRequest, match=message) as refused:
            cell.edit(edit)
        assert refused.value.problem.field == field
    cell.edit(DetachObject(op="detach", name="box"))
    with pytest.raises(InvalidRequest, match="probe_1 is the name of an object, and probe has a shape of this name"):
        cell.mount("probe")
    cell.moving = True
    for change in (lambda: cell.mount("probe"), lambda: cell.unmount("welder")):
        with pytest.raises(Busy, match="the robot is in motion with the tip that it has"):
            change()
    assert cell.store.scene.tools == ("welder",)
    with pytest.raises(InvalidRequest, match="the robot has no tool welder; describe it in `tools`"):
        SceneStore(cell.folder / "other").edit(SceneEdit(edit=MountTool(op="mount", tool="welder")))


def test_object_on_the_flange_stays_there_when_a_tool_is_mounted(cell: Cell) -> None:
    camera = Cuboid(kind="cuboid", name="camera", position=(0.6, 0.6, 0.5), size=(0.05, 0.05, 0.05))
    cell.edit(AddObjects(op="add", objects=(camera,)))
    cell.edit(AttachObject(op="attach", name="camera"))
    cell.mount("welder")
    scene = cell.edit(DetachObject(op="detach", name="camera"))
    (there,) = scene.objects
    assert there.position == pytest.approx(camera.position, abs=1e-9)


def test_capsule_without_length_is_a_ball(tmp_path: Path) -> None:
    path = Path(with_tools(tmp_path))
    path.write_text(path.read_text().replace("b: [0.04, 0, 0.24], radius: 0.01", "b: [0, 0, 0.12], radius: 0.01"))
    assert [one.object.kind for one in Tools.of(load_robot(str(path))).shapes["welder"]] == ["cylinder", "sphere"]


def test_plan_names_no_other_tip_without_a_tool(cell: Cell) -> None:
    target = Pose(position=(0.5, 0.2, 0.6), orientation=(1.0, 0.0, 0.0, 0.0))
    goal = PoseGoal(kind="pose", position=target.position, orientation=target.orientation)
    plain: Plan = cell.planner.plan(PlanRequest(goal=goal))
    assert cell.flange(plain.trajectory.position[-1])[:3, 3] == pytest.approx(target.position, abs=1e-4)


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (("mass: 2.0", "mass: 2.5"), ""),
        (("  welder:\n", "  link_5:\n"), "tools.link_5.tip: link_5 is a link of the URDF"),
        (("touch_links: [link_6]", "touch_links: [tool0]"), "tools.welder.touch_links: tool0 is not a link with"),
        (("    tip: {position: [0.0, 0.0, 0.4]}\n", "    link: flange\n    tip: {position: [0, 0, 0.4]}\n"),
         "tools.probe.link: the link flange is not in the URDF"),
        (("mass: 2.0", "mass: -2.0"), "tools.welder.payload.mass"),
    ],
)  # fmt: skip
def test_faulty_tool_in_a_descriptor_is_named_with_its_line(
    tmp_path: Path, change: tuple[str, str], fault: str
) -> None:
    path = Path(with_tools(tmp_path))
    text = path.read_text()
    path.write_text(text.replace(*change))
    if not fault:
        assert load_robot(str(path)).descriptor.tools.keys() == {"welder", "probe"}
        return
    with pytest.raises(InvalidRequest) as refused:
        load_robot(str(path))
    assert fault in str(refused.value)
    assert f"{path}:" in str(refused.value)


def test_each_arm_of_a_pair_has_its_own_tool(tmp_path: Path) -> None:
    tooled_panda(tmp_path)
    cell = (
        "name: cell\nbase_link: table\nparts:\n"
        "  left: {robot: panda.yaml, xyz: [0, 0.5, 0]}\n  right: {robot: panda.yaml, xyz: [0, -0.5, 0]}\n"
    )
    robot = load_robot(str(composed(tmp_path, cell)))
    home = np.array(robot.descriptor.home)
    model = RobotModel.of(robot)
    store = SceneStore(tmp_path / "state", None, robot.urdf.links, Tools.of(robot))
    planner = Handlers(model, "cell", store, lambda: home)
    for tool in ("left_welder", "right_probe"):
        planner.edit(SceneEdit(edit=MountTool(op="mount", tool=tool)))
    goal = model.fk_link("left_panda_grasptarget", home) @ WELDER
    goal[:3, 3] += (0.05, 0.1, 0.05)
    pose = pose_of(goal)
    target = PoseGoal(kind="pose", position=pose.position, orientation=pose.orientation)
    plan = planner.plan(PlanRequest(goal=target, group="left"))
    last = np.array(plan.trajectory.position[-1])
    assert model.fk_link("left_panda_grasptarget", last) @ WELDER == pytest.approx(goal, abs=2e-4)
    (tip,) = planner.fk(FkRequest(joints=(tuple(home.tolist()),), group="right")).poses
    assert tip.position == pytest.approx(
        (model.fk_link("right_panda_grasptarget", home) @ [0, 0, 0.4, 1])[:3], abs=1e-9
    )
