"""A robot with mass behind the same keys: what is planned is driven, gripped and carried, and nothing else changes."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest

import zarm
from support.command_line import zarm as run_zarm
from support.harness import PATIENCE, ServiceProcess, eventually, router
from zarm_contract.keys import Keys
from zarm_contract.messages import DriverFault, PhysicsState, ServoState
from zarm_contract.robot import ROBOTS, load_robot
from zarm_runtime.bus import Bus

DOWN = (1.0, 0.0, 0.0, 0.0)
WORLD = """
floor: 0.0
objects:
  - {kind: cuboid, name: cube, position: [0.5, 0.0, 0.02], size: [0.04, 0.04, 0.04]}
dynamic:
  cube: {mass: 0.2}
"""


class Cell:
    """A robot with mass, its planner and executor, a client, and the truth."""

    def __init__(
        self,
        stack: ExitStack,
        folder: Path,
        robot: str,
        *physics: str,
        strategy: str,
        with_servo: bool,
        speed: dict[str, str],
    ) -> None:
        self.endpoint = stack.enter_context(router())
        self.bus = stack.enter_context(Bus(self.endpoint))
        self.keys = Keys(load_robot(robot).descriptor.name)
        self.truth: list[PhysicsState] = []
        self.bus.subscribe(self.keys.physics_state, lambda _, state: self.truth.append(state))
        started = {"physics_sim": physics, "planner": (), "executor": ("--strategy", strategy)}
        if with_servo:
            started["servo"] = ()
        for service, arguments in started.items():
            environment = {"ZARM_SIM_SPEED": speed[service]} if service in speed else {}
            process = ServiceProcess(
                service, self.endpoint, folder, robot, arguments=arguments, environment=environment
            )
            stack.enter_context(process).wait_ready(self.bus, self.keys)
        self.robot = stack.enter_context(zarm.connect(self.endpoint))

    def after(self, event: int) -> PhysicsState:
        """The first state of the truth beyond those counted."""
        eventually(lambda: len(self.truth) > event, "the truth is published")
        return self.truth[event]

    def fault(self, **faults: Any) -> None:
        self.bus.call(self.keys.simulated_fault, DriverFault(**faults), timeout=5.0)

    def servo(self) -> ServoState:
        return self.bus.read(self.keys.servo_state, timeout=PATIENCE)

    def now(self) -> PhysicsState:
        return self.after(len(self.truth))


@contextmanager
def cell_of(
    folder: Path,
    robot: str,
    *physics: str,
    strategy: str = "joint_trajectory",
    with_servo: bool = False,
    speed: dict[str, str] | None = None,
) -> Iterator[Cell]:
    """`speed` is that of some of the services."""
    with ExitStack() as stack:
        yield Cell(stack, folder, robot, *physics, strategy=strategy, with_servo=with_servo, speed=speed or {})


@pytest.mark.parametrize("strategy", ["joint_speed", "joint_pose", "joint_trajectory"])
def test_what_is_planned_is_driven_by_every_strategy(strategy: str, tmp_path: Path) -> None:
    with cell_of(tmp_path, "doosan_m1013", strategy=strategy) as cell:
        cell.robot.scene.add(zarm.Cuboid("post", size=(0.1, 0.1, 1.0), position=(0.45, 0.45, 0.5)))
        goal = (1.2, 0.2, 1.2, 0.1, 1.2, 0.3)
        cell.robot.execute(cell.robot.plan(goal))
        truth = cell.now()
        assert truth.position == pytest.approx(goal, abs=0.01)
        assert not [contact for state in cell.truth for contact in state.contacts], "it went round the post"
        assert max(map(abs, truth.effort)) > 10.0, "the drives hold it up"
        assert max(map(abs, cell.robot.joint_state().effort or ())) > 10.0, "and say so"


def test_a_cube_is_picked_and_placed_by_friction_alone(tmp_path: Path) -> None:
    (tmp_path / "world.yaml").write_text(WORLD, encoding="utf-8")
    with cell_of(tmp_path, "panda", "--world", str(tmp_path / "world.yaml")) as cell:
        cell.robot.scene.add(zarm.Cuboid("cube", size=(0.04, 0.04, 0.04), position=(0.5, 0.0, 0.0205)))
        cell.robot.pick("cube", zarm.PoseGoal(zarm.Pose((0.5, 0.0, 0.022), DOWN), tolerance={"theta_z": 0.05}))
        held = cell.now()
        assert held.bodies[0].position[2] > 0.1
        assert {name for contact in held.contacts for name in (contact.first, contact.second)} == {
            "cube",
            "panda_leftfinger",
            "panda_rightfinger",
        }
        assert cell.robot.place(zarm.Pose((0.4, 0.3, 0.03), DOWN)).status == "reached", "they let go and open at once"
        eventually(lambda: cell.now().bodies[0].position[2] < 0.03, "the cube stands on the floor")
        assert cell.now().bodies[0].position[:2] == pytest.approx((0.4, 0.3), abs=0.02)


def test_things_fall_from_a_robot_that_lets_them_go(tmp_path: Path) -> None:
    """An arm without a gripper carries what is attached to it."""
    (tmp_path / "world.yaml").write_text(WORLD, encoding="utf-8")
    with cell_of(tmp_path, "ur5e", "--world", str(tmp_path / "world.yaml")) as cell:
        cell.robot.scene.add(zarm.Cuboid("cube", size=(0.04, 0.04, 0.04), position=(0.5, 0.0, 0.02)))
        cell.robot.execute(cell.robot.plan(zarm.Pose((0.5, 0.0, 0.1), DOWN)))
        cell.robot.scene.attach("cube")
        cell.robot.execute(cell.robot.plan(zarm.Pose((0.4, 0.3, 0.4), DOWN)))
        assert cell.now().bodies[0].position == pytest.approx((0.4, 0.3, 0.32), abs=0.01)
        cell.robot.scene.detach("cube")
        eventually(lambda: cell.now().bodies[0].position[2] < 0.03, "it has fallen to the floor")


def test_another_world_is_loaded_while_it_runs(tmp_path: Path) -> None:
    """What stands is in the scene too, which the planner avoids; what walks is not."""
    with cell_of(tmp_path, "ur5e") as cell:
        assert not cell.robot.simulation.state().bodies
        cell.robot.simulation.load("shelf")
        eventually(lambda: cell.now().bodies, "the world is loaded")
        shown = cell.bus.read(cell.keys.physics_objects, timeout=PATIENCE).objects
        assert {"board_0", "carton_0"} < {item.name for item in shown}
        assert {"board_0", "carton_0"} < {*cell.robot.scene.objects()}
        cell.robot.execute(cell.robot.plan(zarm.Pose((0.4, -0.2, 0.6), (0.0, 0.7071, 0.0, 0.7071))))
        touched = {name for state in cell.truth for one in state.contacts for name in (one.first, one.second)}
        assert not touched & {*load_robot("ur5e").descriptor.collision}
        cell.robot.simulation.load("person")
        assert not any("person" in name for name in cell.robot.scene.objects())
        eventually(lambda: {body.name for body in cell.now().bodies} >= {"person_head"}, "the person walks")
        with pytest.raises(zarm.InvalidRequest, match="unknown world"):
            cell.robot.simulation.load("nowhere")


def test_the_health_of_the_driver_says_what_it_assumes(tmp_path: Path) -> None:
    with cell_of(tmp_path, "doosan_m1013") as cell:
        note = cell.robot.health("physics_sim", timeout=5.0).note
        assert "inertia from geometry with 1000 kg/m³: link_1, link_2" in note


def test_it_has_the_faults_of_a_simulated_driver(tmp_path: Path) -> None:
    with cell_of(tmp_path, "doosan_m1013") as cell:
        plan = cell.robot.plan((0.5, 0.0, 1.5708, 0.0, 1.5708, 0.0))
        with pytest.raises(zarm.ExecutionFailed, match="has reported no new joints"):
            cell.robot.execute(plan, on_progress=lambda _: cell.fault(silent=True))
        cell.fault()


def test_a_push_is_felt_and_ends_the_motion_in_a_fault(tmp_path: Path) -> None:
    shutil.copy(ROBOTS / "ur5e.urdf", tmp_path)
    text = (ROBOTS / "ur5e.yaml").read_text(encoding="utf-8")
    limits = "external_torque_limits: [25, 25, 25, 8, 8, 8]"
    (tmp_path / "ur5e.yaml").write_text(f"{text}\nexecution: {{{limits}}}\n", encoding="utf-8")
    with cell_of(tmp_path, str(tmp_path / "ur5e.yaml"), with_servo=True) as cell:
        there, back = (0.9, -1.2, 1.2, -1.57, -1.57, 0.0), (-0.9, -1.5, 1.5, -1.57, -1.57, 0.0)
        assert cell.robot.execute(cell.robot.plan(there)).status == "succeeded", "nothing pushes"
        assert cell.servo().collision_detection == "on"
        assert "felt by the efforts of the joints" in run_zarm("status", "--connect", cell.endpoint).stdout
        with pytest.raises(zarm.ExecutionFailed, match="something pushes") as failed:
            cell.robot.execute(cell.robot.plan(back), on_progress=lambda _: cell.fault(push=(0.0, 0.0, -80.0)))
        assert failed.value.code == "collision_detected"
        assert cell.robot.state().mode == "fault"
        cell.fault()


def test_with_identified_joints_a_soft_push_is_felt(tmp_path: Path) -> None:
    shutil.copy(ROBOTS / "ur5e.urdf", tmp_path)
    text = (ROBOTS / "ur5e.yaml").read_text(encoding="utf-8")
    there, back = (0.9, -1.2, 1.2, -1.0, -1.0, 0.5), (-0.9, -1.5, 1.5, -1.57, -1.57, -0.5)
    with cell_of(tmp_path, "ur5e", with_servo=True) as cell:
        refused = run_zarm("identify", "--connect", cell.endpoint)
        assert refused.returncode == 3
        assert "let the robot make the motions of its work" in refused.stderr
        while cell.robot.execute(cell.robot.plan(there)).status == "succeeded":
            cell.robot.execute(cell.robot.plan(back))
            identified = run_zarm("identify", "--connect", cell.endpoint)
            if identified.returncode == 0:
                break
    assert "joint_dynamics:" in identified.stdout
    (tmp_path / "ur5e.yaml").write_text(f"{text}\n{identified.stdout}", encoding="utf-8")
    with cell_of(tmp_path, str(tmp_path / "ur5e.yaml"), with_servo=True) as cell:
        assert cell.robot.execute(cell.robot.plan(there)).status == "succeeded", "friction is no collision"
        with pytest.raises(zarm.ExecutionFailed, match="something pushes"):
            cell.robot.execute(cell.robot.plan(back), on_progress=lambda _: cell.fault(push=(0.0, 0.0, -25.0)))


def test_a_driver_without_mass_cannot_be_pushed(endpoint: str, tmp_path: Path) -> None:
    robot = load_robot("ur5e")
    with Bus(endpoint) as bus, ServiceProcess("leeloo_sim", endpoint, tmp_path, "ur5e") as process:
        process.wait_ready(bus, Keys("ur5e"))
        with pytest.raises(zarm.InvalidRequest, match="this driver has no mass") as refused:
            bus.call(Keys(robot.descriptor.name).simulated_fault, DriverFault(push=(1.0, 0.0, 0.0)), timeout=5.0)
        assert refused.value.problem.field == "push"


@pytest.mark.parametrize(
    ("option", "text", "words"),
    [
        ("--drives", "bandwith: 3.0\n", "drives.yaml:1: bandwith: "),
        ("--world", "objects:\n  - {kind: cuboid, name: a, position: [0, 0, 0]}\n", "world.yaml:2: "),
        ("--world", "objects: []\ndynamic:\n  b: {mass: 1}\n", "no object is named b"),
        ("--drives", None, "neither a file nor one of the presets ideal, industrial, hobby, m1013"),
    ],
)
def test_a_faulty_file_is_refused_with_its_line(
    option: str, text: str | None, words: str, endpoint: str, tmp_path: Path
) -> None:
    file = tmp_path / f"{option[2:]}.yaml"
    if text is not None:
        file.write_text(text, encoding="utf-8")
    with ServiceProcess("physics_sim", endpoint, tmp_path, "ur5e", arguments=(option, str(file))) as process:
        assert process.process.wait(60) != 0
        assert words in process.output()


def test_a_density_that_is_none_is_refused(endpoint: str, tmp_path: Path) -> None:
    with ServiceProcess("physics_sim", endpoint, tmp_path, "ur5e", arguments=("--density", "-5")) as process:
        assert process.process.wait(60) != 0
        assert "-5 kg/m³ is no density; give a positive one" in process.output()


def test_a_cell_runs_faster_than_real_time(tmp_path: Path) -> None:
    speed = dict.fromkeys(("physics_sim", "planner", "executor", "servo"), "4")
    with cell_of(tmp_path, "ur5e", with_servo=True, speed=speed) as cell:
        goal = (0.5, -1.57, 1.57, -1.57, -1.57, 0.0)
        plan = cell.robot.plan(goal)
        began, real = cell.now().time, time.monotonic()
        cell.robot.execute(plan)
        state, passed = cell.now(), time.monotonic() - real
        assert state.position == pytest.approx(goal, abs=0.01)
        assert state.time - began > plan.trajectory.time[-1], "the whole motion was simulated"
        assert state.time - began > 1.5 * passed
        assert state.real_time_factor > 1.5


def test_a_real_driver_is_never_moved_faster_than_real_time(tmp_path: Path) -> None:
    """An executor that runs faster does not take the joints of a driver in real time for its robot's."""
    with (
        pytest.raises(AssertionError, match="it moves only a simulated robot that runs as fast"),
        cell_of(tmp_path, "ur5e", speed={"executor": "4"}) as cell,
    ):
        cell.robot.execute(cell.robot.plan((0.5, -1.57, 1.57, -1.57, -1.57, 0.0)))
