"""Plans keep the torques of the joints with what is carried, or say that they do not know them."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from zarm_contract.errors import PlanningFailed
from zarm_contract.messages import (
    AddObjects,
    Attach,
    AttachObject,
    Cuboid,
    JointGoal,
    Move,
    Plan,
    PlanRequest,
    ProgramRequest,
    SceneEdit,
)
from zarm_contract.robot import load_robot
from zarm_geometry.inertia import usable_inertials
from zarm_geometry.robot_model import RobotModel
from zarm_physics_sim.robot_body import add_robot
from zarm_planner.handlers import Handlers
from zarm_planner.scene.store import SceneStore
from zarm_trajectory.trajectory import TimedTrajectory

Array = NDArray[np.float64]

PANDA = load_robot("panda")
MODEL = RobotModel.of(PANDA)
HOME = np.array(PANDA.descriptor.home)
THERE = (1.4, 0.5, 0.3, -1.4, 0.2, 2.2, 0.3)
SIDE = 0.06


def planner(folder: Path, robot: RobotModel = MODEL) -> Handlers:
    home = np.array(robot.robot.descriptor.home)
    return Handlers(robot, robot.robot.descriptor.name, SceneStore(folder), lambda: home)


def block_at_the_tip() -> Cuboid:
    tip = MODEL.fk_tip(HOME)[:3, 3]
    return Cuboid(kind="cuboid", name="block", position=tuple((tip - [0.0, 0.0, 0.05]).tolist()), size=(SIDE,) * 3)


def with_load(folder: Path, mass: float | None) -> Handlers:
    handlers = planner(folder)
    handlers.edit(SceneEdit(edit=AddObjects(op="add", objects=(block_at_the_tip(),))))
    touch = ("panda_hand", "panda_leftfinger", "panda_rightfinger")
    handlers.edit(SceneEdit(edit=AttachObject(op="attach", name="block", touch_links=touch, mass=mass)))
    return handlers


def to_there(handlers: Handlers, **options: object) -> Plan:
    return handlers.plan(PlanRequest(goal=JointGoal(kind="joints", position=THERE), optimize_s=0.0, **options))


def worst(plan: Plan, mass: float) -> float:
    """The largest share of an effort that MuJoCo's inverse dynamics gives, every millisecond."""
    spec = mujoco.MjSpec()
    spec.compiler.degree, spec.compiler.autolimits = False, False
    spec.option.disableflags = mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    add_robot(spec, PANDA, usable_inertials(PANDA)[0], 1000.0)
    body = spec.body(PANDA.descriptor.tip_link).add_body(name="load", pos=[0.0, 0.0, 0.05])
    body.explicitinertial, body.mass, body.ipos = True, mass, [0.0, 0.0, 0.0]
    body.inertia = [mass * SIDE**2 / 6] * 3
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[7:9] = 0.04
    trajectory = TimedTrajectory.of(plan.trajectory, PANDA.descriptor.joints)
    efforts = {joint.name: joint.effort for joint in PANDA.urdf.joint_of_child.values()}
    limit = np.array([efforts[name] for name in PANDA.descriptor.joints], float)
    share = 0.0
    for q, v, a in trajectory.sample(np.arange(0.0, trajectory.duration, 0.001)).transpose(1, 0, 2):
        data.qpos[:7], data.qvel[:7], data.qacc[:7] = q, v, a
        mujoco.mj_inverse(model, data)
        share = max(share, float((np.abs(data.qfrc_inverse[:7]) / limit).max()))
    return share


def test_a_light_robot_moves_as_fast_as_ever_and_says_what_it_needs(tmp_path: Path) -> None:
    plan = to_there(planner(tmp_path))
    assert plan.torque is not None
    assert plan.torque.stretch == 1.0
    assert plan.torque.share == pytest.approx(worst(plan, 1e-9), abs=1e-3)
    assert plan.torque.time <= plan.trajectory.time[-1]


@pytest.mark.parametrize("mass", [5.0, 6.0])
def test_what_is_heavy_is_carried_more_slowly_within_the_efforts(mass: float, tmp_path: Path) -> None:
    light, heavy = to_there(with_load(tmp_path / "light", None)), to_there(with_load(tmp_path / "heavy", mass))
    assert worst(light, mass) > 1.0, "as fast as without a load it would need more than there is"
    assert worst(heavy, mass) <= 1.0
    assert heavy.torque is not None
    assert heavy.torque.share == pytest.approx(worst(heavy, mass), abs=2e-3)
    assert heavy.torque.stretch > 1.0
    assert heavy.trajectory.time[-1] > light.trajectory.time[-1]


def test_what_is_too_heavy_to_hold_is_refused_with_the_joint(tmp_path: Path) -> None:
    handlers = with_load(tmp_path, 30.0)
    with pytest.raises(PlanningFailed, match=r"panda_joint\d would need \d+ Nm to stand still at .* and has \d+"):
        to_there(handlers, max_attempts=2)


def test_a_motion_that_was_slowed_down_is_not_sped_up_again(tmp_path: Path) -> None:
    handlers = with_load(tmp_path, 5.0)
    plan = handlers.plan(PlanRequest(goal=JointGoal(kind="joints", position=THERE), optimize_s=0.1))
    assert worst(plan, 5.0) <= 1.0


def test_a_program_keeps_the_torques_of_each_segment(tmp_path: Path) -> None:
    handlers = planner(tmp_path)
    handlers.edit(SceneEdit(edit=AddObjects(op="add", objects=(block_at_the_tip(),))))
    touch = ("panda_hand", "panda_leftfinger", "panda_rightfinger")
    attach = Attach(kind="attach", object="block", touch_links=touch, mass=5.0)
    there, back = (Move(kind="move", goal=JointGoal(kind="joints", position=q)) for q in (THERE, tuple(HOME.tolist())))
    plan, _ = handlers.program(ProgramRequest(segments=(attach, there, back)))
    assert plan.torque is not None
    assert plan.torque.stretch > 1.0
    assert worst(plan, 5.0) <= 1.0


def test_a_robot_of_unknown_inertia_says_nothing_of_torques(tmp_path: Path) -> None:
    m1013 = RobotModel.of(load_robot("doosan_m1013"))
    goal = JointGoal(kind="joints", position=(0.5, 0.2, 1.2, 0.0, 1.2, 0.0))
    plan = planner(tmp_path, m1013).plan(PlanRequest(goal=goal, optimize_s=0.0))
    assert plan.torque is None
