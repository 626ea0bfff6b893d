from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh

from zarm_runtime.bus import Bus
from zarm_runtime.session import open_client

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


@pytest.fixture
def other(endpoint: str) -> Iterator[Bus]:
    """A second session on the router of `bus`: another process, as far as the router can tell."""
    with Bus(endpoint) as session:
        yield session


@pytest.fixture
def plain(endpoint: str) -> Iterator[zenoh.Session]:
    """A third one, of a program that knows nothing of zarm."""
    with open_client(endpoint) as session:
        yield session


@pytest.fixture
def pendulum(tmp_path: Path) -> Path:
    """The descriptor of the smallest robot there is, to be used as it is or broken."""
    (tmp_path / "pendulum.urdf").write_text(_URDF)
    descriptor = tmp_path / "pendulum.yaml"
    descriptor.write_text(_DESCRIPTOR)
    return descriptor
