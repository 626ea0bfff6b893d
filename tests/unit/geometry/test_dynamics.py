"""The torques of motions against MuJoCo's inverse dynamics, and what a robot may be asked for."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from support.composed import two_pandas
from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import Attached, Cuboid
from zarm_contract.robot import load_robot
from zarm_geometry.dynamics import Dynamics
from zarm_geometry.inertia import usable_inertials
from zarm_geometry.robot_model import RobotModel
from zarm_physics_sim.robot_body import add_robot, link_body
from zarm_physics_sim.simulation import Simulation
from zarm_physics_sim.world import World
from zarm_trajectory.arrays import Array

LOAD = Cuboid(kind="cuboid", name="load", position=(0.1, 0.0, 0.05), size=(0.1, 0.1, 0.1))
CARRIED = Attached(object=LOAD, mass=3.0)


class Peer:
    """MuJoCo's inverse dynamics of a robot, its grippers open, with a load of some `mass` (kg) at the tip."""

    def __init__(self, model: RobotModel, mass: float = 0.0) -> None:
        robot = model.robot
        spec = mujoco.MjSpec()
        spec.compiler.degree, spec.compiler.autolimits = False, False
        spec.option.disableflags = mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
        add_robot(spec, robot, usable_inertials(robot)[0], 1000.0, {})
        if mass > 0.0:
            body = spec.body(link_body(robot.descriptor.tip_link)).add_body(name="load", pos=list(LOAD.position))
            body.explicitinertial, body.mass, body.ipos = True, mass, [0.0, 0.0, 0.0]
            body.inertia = [mass * 0.1**2 / 6] * 3
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        joints = [self._model.joint(name) for name in robot.descriptor.joints]
        self._at = [joint.qposadr[0] for joint in joints]
        self._dofs = [joint.dofadr[0] for joint in joints]
        for gripper in robot.descriptor.grippers.values():
            for name, (multiplier, offset) in gripper.joints(robot.urdf).items():
                self._data.joint(name).qpos[0] = multiplier * gripper.positions[-1] + offset

    def torque(self, q: Array, v: Array, a: Array) -> Array:
        data = self._data
        data.qpos[self._at], data.qvel[self._dofs], data.qacc[self._dofs] = q, v, a
        mujoco.mj_inverse(self._model, data)
        return np.array(data.qfrc_inverse[self._dofs])


def motions(model: RobotModel, count: int = 30) -> list[tuple[Array, Array, Array]]:
    rng = np.random.default_rng(4)
    low, high = np.maximum(model.lower, -2.5), np.minimum(model.upper, 2.5)
    return [
        (rng.uniform(low, high), rng.uniform(-2, 2, model.dof), rng.uniform(-8, 8, model.dof)) for _ in range(count)
    ]


def known(model: RobotModel) -> Dynamics:
    assert model.dynamics is not None
    return model.dynamics


@pytest.mark.parametrize("robot", ["ur5e", "ur10e", "panda"])
def test_torques_are_those_of_pinocchio(robot: str) -> None:
    model = RobotModel.of(load_robot(robot))
    peer = Peer(model)
    for q, v, a in motions(model):
        assert known(model).torque([q], [v], [a])[0] == pytest.approx(peer.torque(q, v, a), abs=1e-3)


def test_what_is_carried_counts_with_its_mass() -> None:
    model = RobotModel.of(load_robot("panda"))
    carrying, peer = model.with_attached([CARRIED], []), Peer(model, 3.0)
    for q, v, a in motions(model):
        assert known(carrying).torque([q], [v], [a])[0] == pytest.approx(peer.torque(q, v, a), abs=2e-3)
    assert np.array_equal(known(carrying).limit, known(model).limit)
    weightless = model.with_attached([CARRIED.model_copy(update={"mass": None})], [])
    q, v, a = motions(model, 1)[0]
    assert np.array_equal(known(weightless).torque([q], [v], [a]), known(model).torque([q], [v], [a]))


def test_a_group_bears_all_joints_while_the_others_stand(tmp_path: Path) -> None:
    whole = RobotModel.of(load_robot(str(two_pandas(tmp_path))))
    q, v, a = motions(whole, 1)[0]
    group = whole.group(["left"], q)
    own = [whole.robot.descriptor.joints.index(name) for name in group.robot.descriptor.joints]
    standing = np.setdiff1d(np.arange(whole.dof), own)
    v[standing] = a[standing] = 0.0
    expected = known(whole).torque([q], [v], [a])[0]
    assert known(group).torque([q[own]], [v[own]], [a[own]])[0] == pytest.approx(expected, abs=1e-9)


def test_a_robot_whose_inertia_is_not_stated_has_unknown_torques() -> None:
    assert RobotModel.of(load_robot("doosan_m1013")).dynamics is None


@pytest.mark.parametrize(
    ("stated", "wrong"), [("10", (1, 2)), ("30", (1,))], ids=["not even at home", "not where the arm is stretched"]
)
def test_an_effort_that_cannot_hold_the_empty_arm_is_no_limit(
    stated: str, wrong: tuple[int, ...], tmp_path: Path
) -> None:
    original = load_robot("ur5e")
    for suffix in (".yaml", ".urdf"):
        text = original.path.with_suffix(suffix).read_text(encoding="utf-8")
        changed = text.replace('effort="150"', f'effort="{stated}"')
        (tmp_path / f"ur5e{suffix}").write_text(changed, encoding="utf-8")
    limit = known(RobotModel.of(load_robot(str(tmp_path / "ur5e.yaml")))).limit
    assert tuple(np.flatnonzero(np.isinf(limit))) == wrong


def test_what_is_mounted_on_a_link_counts_and_changes_no_limit(tmp_path: Path) -> None:
    original = load_robot("ur5e")
    (tmp_path / "ur5e.urdf").write_text(original.path.with_suffix(".urdf").read_text(encoding="utf-8"))
    text = original.path.read_text(encoding="utf-8")
    mounted = "\npayloads:\n  tool0: {mass: 2.5, center: [0.02, 0.0, 0.08]}\n  forearm_link: {mass: 0.8}\n"
    (tmp_path / "ur5e.yaml").write_text(text + mounted, encoding="utf-8")
    model, bare = RobotModel.of(load_robot(str(tmp_path / "ur5e.yaml"))), RobotModel.of(original)
    peer = Peer(model)
    for q, v, a in motions(model, 10):
        torque = known(model).torque([q], [v], [a])[0]
        assert torque == pytest.approx(peer.torque(q, v, a), abs=1e-3)
        assert np.abs(torque - known(bare).torque([q], [v], [a])[0]).max() > 0.5
    assert np.array_equal(known(model).limit, known(bare).limit)
    simulation = Simulation(model.robot, World(), np.array(original.descriptor.home))
    assert np.array_equal(simulation.limit, known(bare).limit)
    (tmp_path / "ur5e.yaml").write_text(text + "\npayloads:\n  gripper: {mass: 1.0}\n", encoding="utf-8")
    with pytest.raises(InvalidRequest, match=r"payloads\.gripper: the link gripper is not in the URDF"):
        load_robot(str(tmp_path / "ur5e.yaml"))
