"""What `zarm` does without a robot on the bus, and how it meets nonsense."""

from __future__ import annotations

import json
import signal
import socketserver
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from support.command_line import ROBOT, ZARM, Router, the_one_line, zarm
from support.harness import free_endpoint
from support.tiers import sampled

INTERRUPTED = """
import importlib.abc, os, signal, sys

class Interrupt(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name == module:
            os.kill(os.getpid(), signal.SIGINT)

module, sys.argv[1:] = sys.argv[1], ["robot", "list"]
sys.meta_path.insert(0, Interrupt())
from zarm_cli.app import main
main()
"""
"""`zarm robot list`, with Ctrl-C as soon as a module is looked for."""


class Refuser(socketserver.BaseRequestHandler):
    """Closes every connection without a word."""


# -- robots --


ROBOTS = (ROBOT, "panda", "ur5e", "ur10e")


def test_the_robots_that_come_with_zarm_are_listed() -> None:
    assert sorted(zarm("robot", "list").stdout.split()) == sorted(ROBOTS)


@pytest.mark.slow  # as in unit/contract/test_robots.py and unit/robot_import/test_checking.py
@pytest.mark.parametrize("robot", sampled(*ROBOTS))
def test_a_robot_that_comes_with_zarm_passes_the_check(robot: str) -> None:
    checked = zarm("robot", "check", robot)
    assert checked.returncode == 0, checked.stderr
    assert "home" in checked.stdout
    assert json.loads(zarm("robot", "check", robot, "--json").stdout)["ok"] is True


def test_a_descriptor_is_explained_fault_by_fault(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("name: Mine\nurdf: mine.urdf\nbase_link: base\ntip_link: tip\njoints: [a]\nhome: [zero]\n")
    checked = zarm("robot", "check", str(file))
    assert checked.returncode == 1
    assert f"{file}:1: name" in checked.stderr
    assert f"{file}:6: home" in checked.stderr
    assert len(checked.stderr.splitlines()) > 2
    faults = json.loads(zarm("robot", "check", str(file), "--json").stdout)
    assert faults["ok"] is False
    assert len(faults["faults"]) == len(checked.stderr.splitlines())


# -- nothing there, and nonsense --


def test_without_a_router_the_remedy_is_said() -> None:
    alone = zarm("status", ZARM_CONNECT=free_endpoint())
    assert alone.returncode == 3
    assert "zarm up" in the_one_line(alone.stderr)


def test_without_a_robot_on_the_bus_the_remedy_is_said(endpoint: str) -> None:
    alone = zarm("plan", "--joints", "0", ZARM_CONNECT=endpoint)
    assert alone.returncode == 3
    assert "zarm up" in the_one_line(alone.stderr)


@pytest.mark.parametrize(
    "line",
    sampled(
        "plan",
        "plan --to 0,0,0 --joints 0",
        "plan --to 0,0",
        "plan --joints a,b",
        "plan --warp 9",
        "execute --velocity-scale 0.5",
        "execute --plan-id p --joints 0",
        "scene add pyramid p --at 0,0,0",
        "nonsense",
    ),
)
def test_nonsense_is_a_usage_error_in_one_line(line: str) -> None:
    result = zarm(*line.split())
    assert result.returncode == 2
    assert the_one_line(result.stderr).startswith("zarm: usage: ")


def test_an_endpoint_that_is_none_is_refused() -> None:
    result = zarm("status", "--connect", "7447")
    assert result.returncode == 1
    assert "tcp/" in the_one_line(result.stderr)


def test_a_hanging_router_is_not_taken_for_a_secured_one(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    with Router(tmp_path, "--listen", endpoint) as router:
        router.interrupt(signal.SIGSTOP)
        result = zarm("status", "--connect", endpoint)
        router.interrupt(signal.SIGCONT)
    assert result.returncode == 3
    assert f"{endpoint} takes connections and does not answer" in (line := the_one_line(result.stderr))
    assert "ZARM_SECURITY" not in line


def test_a_port_where_something_else_listens_is_unavailable() -> None:
    with socketserver.TCPServer(("127.0.0.1", 0), Refuser) as other:
        threading.Thread(target=other.serve_forever).start()
        result = zarm("status", "--connect", f"tcp/127.0.0.1:{other.server_address[1]}")
        other.shutdown()
    assert result.returncode == 3
    assert "is no Zenoh router" in the_one_line(result.stderr)


@pytest.mark.parametrize(
    "module", sampled("zenoh", "zarm_cli.commands", "concurrent.futures", "pydantic", "rich.console")
)
def test_ctrl_c_while_a_command_is_loaded_ends_it_without_a_word(module: str) -> None:
    ended = subprocess.run([sys.executable, "-c", INTERRUPTED, module], capture_output=True, text=True)
    assert (ended.returncode, ended.stderr) == (130, "")


def test_an_output_that_is_full_is_said_in_one_line() -> None:
    for arguments in (("robot", "list"), ("--help",)):
        with Path("/dev/full").open("w") as full:
            ended = subprocess.run([ZARM, *arguments], stdout=full, stderr=subprocess.PIPE, text=True)
        assert ended.returncode == 1
        assert "No space left" in the_one_line(ended.stderr)


def test_a_folder_where_no_certificates_can_be_written_is_named() -> None:
    result = zarm("certs", "/proc/certs")
    assert result.returncode == 1
    assert "/proc/certs" in the_one_line(result.stderr)


def test_help_needs_no_bus() -> None:
    result = zarm("--help", ZARM_CONNECT=free_endpoint())
    assert result.returncode == 0
    assert "execute" in result.stdout
    assert zarm("scene", "--help").returncode == 0
