"""`zarm robot check` finds what a person gets wrong and no schema can."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.examples import examples
from zarm_contract.robot import ROBOTS, RobotDescription, load_robot
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.deadline import Deadline
from zarm_planner.timing.smoothing import smooth_path
from zarm_robot_import.checking import _rates, findings
from zarm_trajectory.limits import Limits

Change = Callable[[str], str]


def changed(folder: Path, descriptor: Change = str, urdf: Change = str) -> list[str]:
    """What is found in the ur5e after these changes of its files."""
    for suffix, change in ((".yaml", descriptor), (".urdf", urdf)):
        before = (ROBOTS / "ur5e").with_suffix(suffix).read_text()
        after = change(before)
        (folder / "ur5e").with_suffix(suffix).write_text(after)
    return findings(load_robot(str(folder / "ur5e.yaml")))


@pytest.mark.lengthy
@pytest.mark.parametrize("robot", sorted(file.stem for file in ROBOTS.glob("*.yaml")))
def test_nothing_is_found_in_the_robots_that_zarm_brings(robot: str) -> None:
    assert findings(load_robot(robot)) == []


@pytest.mark.lengthy
def test_lengths_in_millimetres(tmp_path: Path) -> None:
    def in_millimetres(text: str) -> str:
        return text.replace('xyz="-0.425 0 0"', 'xyz="-425 0 0"')

    found = changed(tmp_path, urdf=in_millimetres)
    assert any(fault.startswith("urdf: an origin is 425 m from its parent") and "mm" in fault for fault in found)


@pytest.mark.lengthy
def test_a_link_that_hangs_in_the_air(tmp_path: Path) -> None:
    found = changed(tmp_path, urdf=lambda text: text.replace('xyz="-0.425 0 0"', 'xyz="-0.425 0 1.425"'))
    assert any(fault.startswith("collision.forearm_link: it never comes nearer") for fault in found)


@pytest.mark.lengthy
def test_home_at_a_limit(tmp_path: Path) -> None:
    limit = load_robot("ur5e").upper[0]
    found = changed(tmp_path, descriptor=lambda text: text.replace("home: [0.0,", f"home: [{limit - 0.001:.4f},"))
    assert "home: shoulder_pan_joint stands at its limit; choose a pose from which it can turn both ways" in found


@pytest.mark.lengthy
def test_spheres_that_are_too_small_or_elsewhere(tmp_path: Path) -> None:
    own = "  wrist_3_link: *wrist_3_link"
    sphere = "  wrist_3_link:\n    - {{kind: sphere, center: [0.0, 0.0, -0.0274], radius: {}}}"
    small = changed(tmp_path, descriptor=lambda text: text.replace(own, sphere.format(0.02)))
    assert any(
        fault.startswith("spheres.wrist_3_link: its exact geometry stands out of its spheres") for fault in small
    )
    large = changed(tmp_path, descriptor=lambda text: text.replace(own, sphere.format(0.2)))
    assert any(fault.startswith("spheres.wrist_3_link[0]: it stands out of the link") for fault in large)


@pytest.mark.lengthy
def test_a_home_in_contact(tmp_path: Path) -> None:
    home = "home: [0.0, -2.2, 1.9, -1.383, -1.57, 0.0]"
    found = changed(tmp_path, descriptor=lambda text: text.replace(home, "home: [0.0, -1.5, 3.1, -1.383, -1.57, 0.0]"))
    assert any(fault.startswith("home: ") and "in contact there" in fault for fault in found)


@pytest.mark.lengthy
def test_self_collision_everywhere(tmp_path: Path) -> None:
    own = "  wrist_3_link: *wrist_3_link"
    huge = "  wrist_3_link: [{kind: sphere, center: [0.0, 0.0, -0.0274], radius: 1.0}]"
    found = changed(tmp_path, descriptor=lambda text: text.replace(own, huge))
    assert any("of all configurations are free of self-collision" in fault for fault in found)


@pytest.mark.lengthy
def test_limits_in_degrees(tmp_path: Path) -> None:
    found = changed(tmp_path, urdf=lambda text: re.sub('lower="[^"]*" upper="[^"]*"', 'lower="-360" upper="360"', text))
    assert any(fault.startswith("elbow_joint: its range is 720 rad wide") for fault in found)


@pytest.mark.lengthy
def test_a_workspace_that_is_a_point(tmp_path: Path) -> None:
    near = 'lower="{0}" upper="{1}"'

    def narrow(text: str) -> str:
        homes = iter((0.0, -2.2, 1.9, -1.383, -1.57, 0.0))
        return re.sub(
            'lower="[^"]*" upper="[^"]*"', lambda _: near.format((home := next(homes)) - 0.005, home + 0.005), text
        )

    found = changed(tmp_path, urdf=narrow)
    assert any(fault.startswith("urdf: over all joint ranges the tip moves by ") for fault in found)


@pytest.mark.lengthy
def test_a_mesh_that_is_not_there(tmp_path: Path) -> None:
    link = '<link name="forearm_link">'
    mesh = '<visual><geometry><mesh filename="package://ur/a.stl"/></geometry></visual>'
    found = changed(tmp_path, urdf=lambda text: text.replace(link, link + mesh))
    assert any("ur5e.urdf:" in fault and "there is no mesh package://ur/a.stl" in fault for fault in found)


def limited(robot: RobotDescription, **values: float) -> RobotDescription:
    """The robot with these limits in its second joint."""
    cspace = robot.descriptor.cspace
    changed = {
        name: tuple(value if k == 1 else one for k, one in enumerate(getattr(cspace, name)))
        for name, value in values.items()
    }
    return dataclasses.replace(
        robot, descriptor=robot.descriptor.model_copy(update={"cspace": cspace.model_copy(update=changed)})
    )


@pytest.mark.lengthy
@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"acceleration": 1e5}, r"cspace.acceleration\[1\]: shoulder_lift_joint with 100000 rad/s² is unlikely"),
        (
            {"jerk": 0.001},
            r"cspace.jerk\[1\]: shoulder_lift_joint with 0.001 rad/s³ is unlikely: arms have 0.2 to 100000",
        ),
        ({"velocity": 180.0}, r"cspace.velocity\[1\]: shoulder_lift_joint with 180 rad/s is unlikely"),
        (
            {"acceleration": 100.0, "jerk": 50.0},
            r"cspace.acceleration\[1\]: .* cannot reach 100 rad/s²: with a jerk of 50 rad/s³",
        ),
        ({"acceleration": 0.05}, r"cspace.velocity\[1\]: .* cannot reach 3.1415 rad/s: within its range"),
    ],
)
def test_limits_that_no_arm_has_or_no_motion_reaches_are_named(values: dict[str, float], says: str) -> None:
    found = findings(limited(load_robot("ur5e"), **values))
    assert any(re.match(says, fault) for fault in found), found


@pytest.mark.lengthy
@examples(0.5)
@given(velocity=st.floats(-3, 3), acceleration=st.floats(-3, 4), jerk=st.floats(-4, 6))
def test_a_robot_in_which_nothing_is_found_moves(velocity: float, acceleration: float, jerk: float) -> None:
    robot = limited(load_robot("ur5e"), velocity=10**velocity, acceleration=10**acceleration, jerk=10**jerk)
    model = RobotModel.of(robot)
    if list(_rates(model)):
        return
    home = np.array(robot.descriptor.home)
    path = np.stack((home, home + 0.1))
    motion = smooth_path(model, World((), 0.0), path, Limits.of(robot), 0.02, seed=0, deadline=Deadline(60.0))
    assert motion.duration < 60.0
