"""The simulated world obeys physics: weights, falls, grips and pushes are what they must be."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from zarm_contract.messages import (
    Attached,
    Cuboid,
    DriverGripperCommand,
    DynamicObject,
)
from zarm_contract.robot import RobotDescription, load_robot
from zarm_geometry.inertia import usable_inertials
from zarm_geometry.robot_model import RobotModel
from zarm_physics_sim.arm import PhysicalArm
from zarm_physics_sim.drives import PRESETS
from zarm_physics_sim.hands import PhysicalHands
from zarm_physics_sim.simulation import STEP, Simulation
from zarm_physics_sim.world import World
from zarm_trajectory.arrays import Array

GRAVITY = 9.81
EMPTY = World()
FINGERS = {"panda_leftfinger": 1.0, "panda_rightfinger": -1.0}
PANDA, UR5E, M1013 = (load_robot(name) for name in ("panda", "ur5e", "doosan_m1013"))


def cube(name: str, x: float, y: float, z: float, size: float = 0.04) -> Cuboid:
    return Cuboid(kind="cuboid", name=name, position=(x, y, z), size=(size, size, size))


def home(robot: RobotDescription) -> Array:
    return np.array(robot.descriptor.home)


def arm_in(simulation: Simulation, preset: str = "ideal", seed: int = 1) -> PhysicalArm:
    joints = range(len(simulation.robot.descriptor.joints))
    return PhysicalArm(simulation, PRESETS[preset], joints, seed, lambda _: None)


def pass_time(arm: PhysicalArm, seconds: float) -> None:
    for _ in range(round(seconds / 0.01)):
        arm.step()


@pytest.mark.parametrize("robot", [UR5E, PANDA], ids=["ur5e", "panda"])
def test_gravity_torque_is_the_slope_of_potential_energy(robot: RobotDescription) -> None:
    """Masses, centres and joints of the simulation against zarm's own kinematics."""
    model, inertials = RobotModel.of(robot), usable_inertials(robot)[0]

    def energy(q: Array) -> float:
        heights = [
            inertial.mass * (model.fk_link(link, q) @ [*inertial.xyz, 1.0])[2]
            for link, inertial in inertials.items()
            if link not in FINGERS
        ]
        hand = model.fk_link("panda_hand", q) if robot is PANDA else np.eye(4)
        heights += [
            inertials[link].mass
            * (hand @ [0.0, side * 0.04 + inertials[link].xyz[1], 0.0584 + inertials[link].xyz[2], 1.0])[2]
            for link, side in FINGERS.items()
            if link in inertials
        ]  # open
        return GRAVITY * float(sum(heights))

    rng, step = np.random.default_rng(3), 1e-5
    for _ in range(5):
        q = home(robot) + rng.uniform(-0.4, 0.4, len(home(robot)))
        slope = [(energy(q + step * e) - energy(q - step * e)) / (2.0 * step) for e in np.eye(len(q))]
        assert Simulation(robot, EMPTY, q).bias == pytest.approx(slope, abs=1e-3)


def test_without_inertia_an_arm_weighs_what_its_geometry_does() -> None:
    heavy = Simulation(M1013, EMPTY, home(M1013), density=2000.0)
    light = Simulation(M1013, EMPTY, home(M1013), density=1000.0)
    assert set(light.assumed) == set(M1013.descriptor.collision) - {"base_link"}
    assert heavy.bias == pytest.approx(2.0 * light.bias)


def test_an_inertial_outside_of_its_link_is_named_and_not_used(tmp_path: Path) -> None:
    """The published one of the M1013: the centre of a link of 10 cm at 1.40 m."""
    wrong = '<link name="link_6"><inertial><origin xyz="0 0 1.4"/><mass value="0.6"/><inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    robot = load_robot(str(changed_m1013(tmp_path, '<link name="link_6"/>', wrong)))
    simulation = Simulation(robot, EMPTY, home(robot))
    (fault,) = simulation.faults
    assert "link_6: its centre of mass is 1.3" in fault
    assert "link_6" in simulation.assumed


def test_impossible_moments_of_inertia_are_corrected_and_named() -> None:
    """Those that Franka published for the fourth link."""
    inertials, faults = usable_inertials(PANDA)
    assert [fault.split(":")[0] for fault in faults] == ["panda_link4"]
    xx, yy, zz, xy, xz, yz = inertials["panda_link4"].inertia
    moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    assert moments[2] == pytest.approx(moments[0] + moments[1])


def test_an_effort_that_cannot_hold_the_arm_is_no_limit(tmp_path: Path) -> None:
    """The published one of the M1013: 30 Nm for every joint."""
    robot = load_robot(str(changed_m1013(tmp_path, 'effort="346"', 'effort="30"')))
    weak = Simulation(robot, EMPTY, home(robot))
    joints = robot.descriptor.joints
    assert [joints[k] for k in np.flatnonzero(np.isinf(weak.limit))] == ["joint_2"]
    assert np.isfinite(Simulation(M1013, EMPTY, home(M1013)).limit).all()


def changed_m1013(folder: Path, old: str, new: str) -> Path:
    for suffix in (".yaml", ".urdf"):
        text = M1013.path.with_suffix(suffix).read_text(encoding="utf-8")
        (folder / f"doosan_m1013{suffix}").write_text(text.replace(old, new), encoding="utf-8")
    return folder / "doosan_m1013.yaml"


def test_what_falls_comes_to_rest_on_the_floor_with_its_weight() -> None:
    world = World(
        {"cube": cube("cube", 0.6, 0.0, 0.3)}, dynamic={"cube": DynamicObject(name="cube", mass=0.5)}, floor=0.0
    )
    simulation = Simulation(UR5E, world, home(UR5E))
    pass_time(arm_in(simulation), 1.5)
    position, _ = simulation.poses()["cube"]
    assert position == pytest.approx([0.6, 0.0, 0.02], abs=2e-3)
    pressing = [contact for contact in simulation.contacts() if {contact.first, contact.second} == {"floor", "cube"}]
    assert sum(contact.force for contact in pressing) == pytest.approx(0.5 * GRAVITY, rel=0.02)


def test_an_arm_is_stopped_by_a_wall_and_presses_on_it() -> None:
    ahead = RobotModel.of(UR5E).fk_tip(home(UR5E) + [1.0, 0.0, 0.0, 0.0, 0.0, 0.0])[:3, 3]
    wall = cube("wall", *map(float, ahead), 0.2)
    simulation = Simulation(UR5E, World({"wall": wall}), home(UR5E))
    arm = arm_in(simulation)
    turn = home(UR5E) + np.outer(np.linspace(0.0, 1.0, 100), [1.5, 0.0, 0.0, 0.0, 0.0, 0.0])
    arm.play(turn, np.empty((0, 6)))
    pass_time(arm, 2.5)
    assert simulation.position[0] < home(UR5E)[0] + 1.4
    pressing = [contact for contact in simulation.contacts() if "wall" in (contact.first, contact.second)]
    assert sum(contact.force for contact in pressing) > 20.0


@pytest.mark.parametrize(("mass", "held"), [(0.3, True), (20.0, False)], ids=["light", "too heavy"])
def test_a_gripper_holds_by_friction_what_is_light_enough(mass: float, held: bool) -> None:
    """70 N on each side and a friction of 1: 14 kg at most."""
    tip = RobotModel.of(PANDA).fk_tip(home(PANDA))[:3, 3]
    below = cube("table", float(tip[0]), float(tip[1]), float(tip[2]) - 0.04)
    thing = cube("cube", *map(float, tip))
    world = World({"table": below, "cube": thing}, dynamic={"cube": DynamicObject(name="cube", mass=mass)})
    simulation = Simulation(PANDA, world, home(PANDA))
    arm = arm_in(simulation)
    command = DriverGripperCommand(gripper="hand", sequence=1, position=0.0, speed=0.05, force=70.0)
    PhysicalHands(arm).play(command)
    pass_time(arm, 1.0)
    assert simulation.finger_position == pytest.approx(0.024, abs=1e-3), (
        "the cube stops the fingers, whose tips are balls"
    )
    arm.change_world(World({"cube": thing}, dynamic=world.dynamic), ())  # the table is taken away
    pass_time(arm, 1.0)
    height = arm.simulation.poses()["cube"][0][2]
    assert (height > tip[2] - 0.02) == held


def test_an_attached_thing_moves_along_until_detached() -> None:
    tip = RobotModel.of(UR5E).fk_tip(home(UR5E))[:3, 3]
    thing = cube("cube", float(tip[0]), float(tip[1]), float(tip[2]) - 0.1)
    world = World({"cube": thing}, dynamic={"cube": DynamicObject(name="cube", mass=0.5)}, floor=0.0)
    arm = arm_in(Simulation(UR5E, world, home(UR5E)))
    arm.change_world(world, [Attached(object=thing)])
    turn = home(UR5E) + np.outer(np.linspace(0.0, 1.0, 100), [1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    arm.play(turn, np.empty((0, 6)))
    pass_time(arm, 2.5)
    moved = RobotModel.of(UR5E).fk_tip(arm.simulation.position)[:3, 3]
    assert arm.simulation.poses()["cube"][0] == pytest.approx(moved - [0.0, 0.0, 0.1], abs=5e-3)
    arm.change_world(world, ())
    pass_time(arm, 1.5)
    assert arm.simulation.poses()["cube"][0][2] == pytest.approx(0.02, abs=2e-3)


def test_a_new_world_leaves_everything_as_it_moves() -> None:
    world = World({"cube": cube("cube", 0.6, 0.0, 0.5)}, dynamic={"cube": DynamicObject(name="cube", mass=0.5)})
    arm = arm_in(Simulation(UR5E, world, home(UR5E)))
    arm.play(home(UR5E) + np.outer(np.linspace(0.0, 1.0, 50), np.full(6, 0.3)), np.empty((0, 6)))
    pass_time(arm, 0.3)
    before = arm.simulation
    other = World({**world.objects, "post": cube("post", 0.0, 0.9, 0.1)}, dynamic=world.dynamic)
    arm.change_world(other, ())
    after = arm.simulation
    assert after is not before
    assert np.array_equal(after.position, before.position)
    assert np.array_equal(after.velocity, before.velocity)
    assert after.time == before.time
    assert np.array_equal(after.poses()["cube"][0], before.poses()["cube"][0])
    assert after.limit == pytest.approx(before.limit)


def test_the_same_seed_gives_the_same_motion() -> None:
    def run(seed: int) -> list[Array]:
        arm = arm_in(Simulation(UR5E, EMPTY, home(UR5E)), "industrial", seed)
        arm.play(home(UR5E) + np.outer(np.linspace(0.0, 1.0, 50), np.full(6, 0.3)), np.empty((0, 6)))
        pass_time(arm, 0.5)
        return [arm.position, arm.simulation.position]

    assert np.array_equal(run(1), run(1))
    assert not np.array_equal(run(1), run(2))


def test_each_preset_brings_the_arm_where_it_is_sent() -> None:
    """The better the drives, the closer: the tracking error grows from one preset to the next."""
    errors = []
    for preset in ("ideal", "industrial", "hobby"):
        arm = arm_in(Simulation(UR5E, EMPTY, home(UR5E)), preset)
        u = np.linspace(0.0, 1.0, 101)[1:, None]
        arm.play(home(UR5E) + u**3 * (10 - 15 * u + 6 * u * u) * 0.5, np.empty((0, 6)))
        pass_time(arm, 3.0)
        errors.append(float(np.abs(arm.simulation.position - home(UR5E) - 0.5).max()))
    assert errors[0] < 1e-4 < errors[1] < 2e-3 < errors[2] < 0.1


def test_time_passes_in_steps_of_a_millisecond() -> None:
    simulation = Simulation(UR5E, EMPTY, home(UR5E))
    pass_time(arm_in(simulation), 0.25)
    assert simulation.time == pytest.approx(0.25, abs=STEP / 2)


def test_a_robot_may_have_a_link_named_world(tmp_path: Path) -> None:
    for suffix in ("urdf", "yaml"):
        text = Path(UR5E.urdf_path).with_suffix(f".{suffix}").read_text(encoding="utf-8")
        (tmp_path / f"ur5e.{suffix}").write_text(text.replace("base_link", "world"), encoding="utf-8")
    text = (tmp_path / "ur5e.yaml").read_text(encoding="utf-8")
    (tmp_path / "ur5e.yaml").write_text(text.replace("world:", "base_link:", 1), encoding="utf-8")
    robot = load_robot(str(tmp_path / "ur5e.yaml"))
    assert robot.descriptor.base_link == "world"
    np.testing.assert_allclose(Simulation(robot, EMPTY, home(robot)).bias, Simulation(UR5E, EMPTY, home(UR5E)).bias)
