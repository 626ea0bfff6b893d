"""A small arm for tests: it turns, bends twice and slides, beside a post, and has every kind of collision primitive."""

from __future__ import annotations

from pathlib import Path

from zarm_contract.robot import RobotDescription, load_robot

URDF = """<robot name="small_arm">
  <link name="stand"/> <link name="turret"/> <link name="upper"/> <link name="fore"/> <link name="cover"/> <link name="rod"/>
  <joint name="turn" type="continuous">
    <parent link="stand"/><child link="turret"/><origin xyz="0 0 0.2"/><axis xyz="0 0 1"/>
  </joint>
  <joint name="bend" type="revolute">
    <parent link="turret"/><child link="upper"/><origin xyz="0 0.05 0.1"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2"/>
  </joint>
  <joint name="elbow" type="revolute">
    <parent link="upper"/><child link="fore"/><origin xyz="0 0 0.4" rpy="0.3 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-2.5" upper="2.5"/>
  </joint>
  <joint name="mount" type="fixed">
    <parent link="fore"/><child link="cover"/><origin xyz="0.02 0 0.1" rpy="0 0.2 0"/>
  </joint>
  <joint name="slide" type="prismatic">
    <parent link="fore"/><child link="rod"/><origin xyz="0 0 0.2"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="0.2"/>
  </joint>
</robot>
"""

DESCRIPTOR = """
name: small_arm
urdf: small_arm.urdf
base_link: stand
tip_link: rod
joints: [turn, bend, elbow, slide]
home: [0, 0.5, 1, 0.1]
cspace:
  velocity: [1.5, 1.5, 2, 0.5]
  acceleration: [3, 2, 4, 1]
  jerk: [300, 200, 400, 100]
spheres:
  stand: [{center: [0, 0, 0.06], radius: 0.12}, {center: [-0.5, 0, 0.3], radius: 0.05}]
  turret: [{center: [0, 0, 0.03], radius: 0.11}]
  upper: [{center: [0, 0, 0.05], radius: 0.09}, {center: [0, 0, 0.18], radius: 0.09}, {center: [0, 0, 0.3], radius: 0.09}]
  fore: [{center: [0, 0, 0.05], radius: 0.08}, {center: [0, 0, 0.14], radius: 0.08}]
  cover: [{center: [0, 0, 0], radius: 0.06}]
  rod: [{center: [0, 0, 0], radius: 0.03}]
collision:
  stand: [{kind: cylinder, a: [0, 0, 0], b: [0, 0, 0.12], radius: 0.08}, {kind: sphere, center: [-0.5, 0, 0.3], radius: 0.05}]
  turret: [{kind: cylinder, a: [0, 0, -0.02], b: [0, 0, 0.08], radius: 0.07}]
  upper: [{kind: capsule, a: [0, 0, 0.05], b: [0, 0, 0.32], radius: 0.05}]
  fore:
    - {kind: capsule, a: [0, 0, 0.05], b: [0, 0, 0.15], radius: 0.03}
    - {kind: cylinder, a: [0, -0.04, 0], b: [0, 0.04, 0], radius: 0.05}
  cover: [{kind: cuboid, center: [0, 0, 0], orientation: [0, 0, 0.6, 0.8], size: [0.06, 0.05, 0.08]}]
  rod: [{kind: sphere, center: [0, 0, 0], radius: 0.03}]
self_collision_ignore: [[stand, turret], [turret, upper], [upper, fore], [fore, rod], [cover, rod]]
interpolation_dt: 0.02
"""


def small_arm(folder: Path) -> RobotDescription:
    """The arm's descriptor, written to `folder` and read from there."""
    (folder / "small_arm.urdf").write_text(URDF)
    (folder / "small_arm.yaml").write_text(DESCRIPTOR)
    return load_robot(str(folder / "small_arm.yaml"))
