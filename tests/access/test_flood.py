"""Whoever has no certificate can keep newcomers out of a router, though not those whose sessions exist; a firewall helps."""

from __future__ import annotations

import shutil
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest

from support.command_line import Router, environment, zarm
from support.harness import PATIENCE, eventually, free_endpoint
from support.network.two_hosts import PORT, Host, obstacle
from support.network.wire import wire
from support.paths import PROGRAMS, ROOT
from zarm_contract.keys import Keys
from zarm_contract.messages import ExecutorState, Nothing
from zarm_runtime.bus import Bus

pytestmark = pytest.mark.slow

KEYS = Keys("some_robot")
FLOOD = str(PROGRAMS / "flood.py")
FIREWALL = str(ROOT / "deploy" / "firewall.nft")
JOIN = "import sys; from zarm_runtime.bus import Bus; Bus(sys.argv[1], timeout=2.0).close()"


def joins(endpoint: str, certificates: Path, *prefix: str) -> bool:
    """Whether an operator who comes now gets a session within 2 s."""
    came = subprocess.run(
        [*prefix, sys.executable, "-c", JOIN, endpoint],
        env=environment(ZARM_SECURITY="on", ZARM_CERTS=str(certificates)),
        stderr=subprocess.DEVNULL,
        timeout=PATIENCE,
    )
    return came.returncode == 0


def test_a_stop_gets_through_while_a_flood_keeps_newcomers_out(secured: Path, tmp_path: Path) -> None:
    endpoint = free_endpoint()
    with (
        Router(tmp_path, "--listen", endpoint, ZARM_SECURITY="on", ZARM_CERTS=str(secured)),
        Bus(endpoint, role="executor") as executor,
        Bus(endpoint, role="viewer") as viewer,
    ):
        state = ExecutorState(mode="idle", strategy="emulator", speed_scale=1.0, missed_ticks=0)
        executor.serve(KEYS.stop, lambda _: state)
        flood = subprocess.Popen([sys.executable, FLOOD, *endpoint.removeprefix("tcp/").split(":")])
        try:
            eventually(lambda: not joins(endpoint, secured), "newcomers are kept out")
            for _ in range(100):
                viewer.call(KEYS.stop, Nothing(), timeout=5)
            assert not joins(endpoint, secured)
        finally:
            flood.kill()
            flood.wait()


def missing() -> str | None:
    """What the test of the firewall lacks, or None."""
    if (other := obstacle()) is not None:
        return other
    if shutil.which("nft") is None:
        return "a firewall needs nftables (apt-get install nftables)"
    tried = subprocess.run(["unshare", "--net", "nft", "-f", FIREWALL], capture_output=True, text=True)
    return None if tried.returncode == 0 else f"this kernel takes no such firewall: {tried.stderr}"


@pytest.mark.skipif(bool(missing()), reason=missing() or "")
def test_the_firewall_keeps_a_flood_from_keeping_others_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    certificates = tmp_path / "certs"
    made = zarm("certs", str(certificates), "--host", "10.78.0.1")
    assert made.returncode == 0, made.stderr
    monkeypatch.setenv("ZARM_SECURITY", "on")
    monkeypatch.setenv("ZARM_CERTS", str(certificates))
    with ExitStack() as stack:
        router, attacker, operator = (
            Host(stack, name, f"10.78.0.{number}", tmp_path)
            for number, name in enumerate(("router", "attacker", "operator"), start=1)
        )
        ends = [stack.enter_context(wire()).ends for _ in range(2)]
        for host, (near, far) in zip((attacker, operator), ends, strict=True):
            router.plug_in(near, host.address)
            host.plug_in(far, router.address)
        router.start_router("--listen", f"tls/0.0.0.0:{PORT}")

        def operator_joins() -> bool:
            return joins(f"tls/{router.address}:{PORT}", certificates, *operator.run())

        stack.enter_context(attacker.runs(sys.executable, FLOOD, router.address, str(PORT)))
        eventually(lambda: not operator_joins(), "the operator is kept out")
        subprocess.run(router.run("nft", "-f", FIREWALL), check=True)
        eventually(operator_joins, "the operator gets in")
        assert [operator_joins() for _ in range(5)] == [True] * 5
