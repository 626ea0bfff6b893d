"""The smallest robot there is: one joint, one sphere, one capsule."""

from __future__ import annotations

from pathlib import Path

_URDF = """<robot name="pendulum">
  <link name="base"/><link name="arm"/><link name="tip"/>
  <joint name="swing" type="revolute">
    <parent link="base"/><child link="arm"/><origin xyz="0 0 0.1"/><axis xyz="0 1 0"/>
    <limit lower="-1.5" upper="1.5" velocity="1" effort="1"/>
  </joint>
  <joint name="flange" type="fixed"><parent link="arm"/><child link="tip"/><origin xyz="0 0 0.3"/></joint>
</robot>
"""

_DESCRIPTOR = """\
name: pendulum
urdf: pendulum.urdf
base_link: base
tip_link: tip
joints: [swing]
home: [0.0]
cspace:
  velocity: [1.0]
  acceleration: [2.0]
  jerk: [10.0]
spheres:
  arm:
    - {center: [0, 0, 0.15], radius: 0.16}
collision:
  arm:
    - {kind: capsule, a: [0, 0, 0.05], b: [0, 0, 0.25], radius: 0.05}
self_collision_ignore: []
"""


def write_pendulum(folder: Path) -> Path:
    """Its descriptor, and its URDF beside it."""
    (folder / "pendulum.urdf").write_text(_URDF)
    descriptor = folder / "pendulum.yaml"
    descriptor.write_text(_DESCRIPTOR)
    return descriptor
