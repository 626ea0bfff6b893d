"""The M1013 with tools."""

from __future__ import annotations

from pathlib import Path

from zarm_contract.robot import ROBOTS, RobotDescription, load_robot

TOOLS = """
tools:
  welder:
    tip: {position: [0.05, 0.0, 0.25], orientation: [0.0, 0.7071067811865476, 0.0, 0.7071067811865476]}
    collision:
      - {kind: cylinder, a: [0, 0, 0.02], b: [0, 0, 0.12], radius: 0.03}
      - {kind: capsule, a: [0, 0, 0.12], b: [0.04, 0, 0.24], radius: 0.01}
    touch_links: [link_6]
    payload: {mass: 2.0, center: [0.0, 0.0, 0.08]}
  probe:
    tip: {position: [0.0, 0.0, 0.4]}
    collision:
      - {kind: cuboid, center: [0, 0, 0.2], size: [0.02, 0.02, 0.36]}
"""


def with_tools(folder: Path) -> str:
    """Writes the descriptor; returns its path."""
    text = (ROBOTS / "doosan_m1013.yaml").read_text()
    path = folder / "doosan_m1013.yaml"
    path.write_text(text + TOOLS)
    (folder / "doosan_m1013.urdf").write_text((ROBOTS / "doosan_m1013.urdf").read_text())
    return str(path)


def tooled_panda(folder: Path) -> RobotDescription:
    """A Panda, whose URDF has masses, with the same tools."""
    panda = load_robot("panda")
    (folder / "panda.urdf").write_text(panda.urdf_path.read_text())
    (folder / "panda.yaml").write_text(panda.path.read_text() + TOOLS.replace("[link_6]", "[]"))
    return load_robot(str(folder / "panda.yaml"))


def tooled_robot(folder: Path) -> RobotDescription:
    """The robot, loaded."""
    return load_robot(with_tools(folder))
