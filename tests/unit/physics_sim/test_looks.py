"""Cameras see the visual meshes of links; what touches, and what has mass, is the exact geometry."""

from __future__ import annotations

import logging
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh

from zarm_contract.robot import RobotDescription, load_robot
from zarm_physics_sim.simulation import Simulation
from zarm_physics_sim.world import World

ROBOTS = Path(load_robot("ur5e").urdf_path).parent
UR5E = load_robot("ur5e")
HOME = np.array(UR5E.descriptor.home)
SIZE = 0.8
"""Edge (m) of the cube that the base link looks like."""


def looking_like(folder: Path, mesh: bytes | None) -> RobotDescription:
    """A UR5e whose base link has this STL file as its visual mesh, 0.1 m higher than its frame."""
    shutil.copy(ROBOTS / "ur5e.yaml", folder)
    text = (ROBOTS / "ur5e.urdf").read_text(encoding="utf-8")
    visual = '<visual><origin xyz="0 0 0.1" rpy="0 0 1.5707963"/><geometry><mesh filename="look.stl" scale="0.1 0.1 0.1"/></geometry></visual>'
    base = re.escape(UR5E.descriptor.base_link)
    open_tag = re.search(rf'<link name="{base}"\s*(/?)>', text)
    assert open_tag is not None
    whole = f'<link name="{UR5E.descriptor.base_link}">{visual}' + ("</link>" if open_tag[1] else "")
    (folder / "ur5e.urdf").write_text(text.replace(open_tag[0], whole, 1), encoding="utf-8")
    if mesh is not None:
        (folder / "look.stl").write_bytes(mesh)
    return load_robot(str(folder / "ur5e.yaml"))


def box() -> bytes:
    exported: bytes = trimesh.creation.box((10.0 * SIZE,) * 3).export(file_type="stl")
    return exported


def seen(simulation: Simulation) -> float:
    """How far (m) it is from beside the robot to what is seen of its base."""
    beside, towards = np.array([3.0, 0.0, 0.05]), np.array([[-1.0, 0.0, 0.0]])
    distance: float = simulation.cast(simulation.snapshot(), beside, towards, 10.0)[0]
    return distance


def test_a_visual_mesh_is_seen_where_the_urdf_has_it(tmp_path: Path) -> None:
    simulation = Simulation(looking_like(tmp_path, box()), World(), HOME)
    assert seen(simulation) == pytest.approx(3.0 - SIZE / 2, abs=1e-4)
    assert seen(Simulation(UR5E, World(), HOME)) > 2.8


def test_a_visual_mesh_has_no_mass_and_touches_nothing(tmp_path: Path) -> None:
    simulation, plain = Simulation(looking_like(tmp_path, box()), World(), HOME), Simulation(UR5E, World(), HOME)
    np.testing.assert_allclose(simulation.bias, plain.bias)
    for each in (simulation, plain):
        each.place(HOME)
        each.step(np.zeros(6), np.zeros(0))
    assert not list(simulation.contacts()), "the cube would enclose half the arm"
    np.testing.assert_allclose(simulation.velocity, plain.velocity)


def test_with_an_unreadable_mesh_the_geometry_is_seen(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        simulation = Simulation(looking_like(tmp_path, b"no mesh"), World(), HOME)
    assert "visual mesh not rendered link=base_link" in caplog.text
    assert seen(simulation) == pytest.approx(seen(Simulation(UR5E, World(), HOME)))


def test_with_a_missing_mesh_the_geometry_is_seen(tmp_path: Path) -> None:
    simulation = Simulation(looking_like(tmp_path, None), World(), HOME)
    assert seen(simulation) == pytest.approx(seen(Simulation(UR5E, World(), HOME)))
