"""Kinematics of the planner's process: batches over the bus, and torch in memory only once a request asks for it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from support.harness import ServiceProcess
from zarm_contract.errors import InvalidRequest
from zarm_contract.keys import Keys
from zarm_contract.messages import FkPoses, FkRequest, IkRequest, IkSolutions
from zarm_contract.robot import load_robot
from zarm_runtime.bus import Bus

ROBOT = load_robot("ur5e")
KEYS = Keys("ur5e")


@pytest.fixture
def planner(endpoint: str, bus: Bus, tmp_path: Path) -> Iterator[ServiceProcess]:
    with ServiceProcess("planner", endpoint, tmp_path, robot="ur5e") as process:
        process.wait_ready(bus, KEYS)
        yield process


def libraries(process: ServiceProcess) -> str:
    """The files that a process has in its memory."""
    return Path(f"/proc/{process.process.pid}/maps").read_text()


@pytest.mark.slow
def test_torch_is_loaded_on_demand_and_agrees_with_the_kernels(planner: ServiceProcess, bus: Bus) -> None:
    rng = np.random.default_rng(0)
    joints = tuple(map(tuple, rng.uniform(-3.0, 3.0, (20, 6)).tolist()))

    def fk(device: str) -> FkPoses:
        return bus.call(KEYS.fk, FkRequest(joints=joints, device=device), timeout=60)

    def ik(poses: FkPoses, device: str) -> IkSolutions:
        request = IkRequest(poses=poses.poses, near=ROBOT.descriptor.home, collision_free=False, device=device)
        return bus.call(KEYS.ik, request, timeout=60)

    poses = fk("auto")
    assert all(len(rows) == 1 for rows in ik(poses, "auto").solutions)
    assert all(len(rows) == 1 for rows in ik(poses, "kernels").solutions)
    assert "libtorch" not in libraries(planner)
    with pytest.raises(InvalidRequest) as raised:
        bus.call(KEYS.fk, FkRequest(joints=((0.0,) * 5,), device="cpu"), timeout=60)
    assert raised.value.problem.field == "joints.0"
    assert "libtorch" not in libraries(planner)

    for one, other in zip(poses.poses, fk("cpu").poses, strict=True):
        np.testing.assert_allclose(one.position, other.position, atol=1e-6)
        np.testing.assert_allclose(one.orientation, other.orientation, atol=1e-6)
    assert "libtorch" in libraries(planner)
    solutions = tuple(rows[0] for rows in ik(poses, "cpu").solutions)
    there = bus.call(KEYS.fk, FkRequest(joints=solutions), timeout=60)
    for one, other in zip(poses.poses, there.poses, strict=True):
        np.testing.assert_allclose(one.position, other.position, atol=1e-6)
        np.testing.assert_allclose(one.orientation, other.orientation, atol=1e-6)
