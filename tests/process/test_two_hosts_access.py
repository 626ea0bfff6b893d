"""Two machines whose routers know each other by their certificates."""

from __future__ import annotations

import json
from contextlib import ExitStack
from pathlib import Path

import pytest

from support.command_line import vector, zarm
from support.network.lab import AWAY, Lab
from support.network.two_hosts import obstacle

pytestmark = pytest.mark.skipif(bool(obstacle()), reason=obstacle() or "")


@pytest.mark.slow
def test_with_certificates_two_hosts_are_one_bus_after_a_cut_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = zarm("certs", str(tmp_path / "certs"), "--host", "10.77.0.2")
    assert made.returncode == 0, made.stderr
    monkeypatch.setenv("ZARM_SECURITY", "on")
    monkeypatch.setenv("ZARM_CERTS", str(tmp_path / "certs"))
    with ExitStack() as stack:
        lab = Lab(stack, tmp_path)
        executed = lab.workstation.zarm("execute", "--joints", vector(tuple(AWAY)), "--json")
        assert executed.returncode == 0, executed.stderr
        assert json.loads(executed.stdout)["status"] == "succeeded"
        lab.lose_each_other()
        lab.restore()
        lab.goes_on()
