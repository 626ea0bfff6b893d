"""`zarm demo`: it runs anywhere, any number of times, and leaves nothing behind."""

from __future__ import annotations

import os
import pty
from contextlib import ExitStack
from ctypes.util import find_library
from pathlib import Path

import pytest

from support.command_line import Command
from support.harness import eventually, free_endpoint
from support.tiers import sampled


@pytest.mark.parametrize("count", sampled(1, 2))
def test_concurrent_demos_plan_around_the_post(tmp_path: Path, count: int) -> None:
    with ExitStack() as stack:
        for demo in [stack.enter_context(Command("demo", folder=tmp_path)) for _ in range(count)]:
            assert demo.end() == 0, demo.errors()
            assert "post" in demo.output()
            assert "clearance" in demo.output()
            assert "succeeded" in demo.output()
            assert demo.family() == []
            assert demo.errors() == ""


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.skipif(not (find_library("EGL") or find_library("OSMesa")), reason="nothing renders here")
def test_with_physics_the_arm_sorts_and_avoids_what_falls(tmp_path: Path) -> None:
    with Command("demo", "--physics", folder=tmp_path) as demo:
        assert demo.end(240.0) == 0, demo.errors()
        assert "sees 4 blocks" in demo.output()
        assert demo.output().count("is in the tray") == 4
        assert "went around it" in demo.output()
        assert "The parcel stands 0 mm beside where it fell." in demo.output()
        assert "level=ERROR" not in demo.errors(), "that the arm was held is a warning"
        assert demo.family() == []


@pytest.mark.slow
@pytest.mark.parametrize("moment", ["zarm_planner.service", "end_with_parent"])
def test_ctrl_c_while_the_demo_starts_leaves_no_process(tmp_path: Path, moment: str) -> None:
    with Command("demo", folder=tmp_path) as demo:
        eventually(lambda: any(moment in " ".join(line) for line in demo.command_lines()), f"{moment} runs")
        demo.interrupt()
        assert demo.end() == 130
        assert demo.family() == []


@pytest.mark.slow
@pytest.mark.parametrize("moment", ["reached", "ready", "clearance"])
def test_ctrl_c_in_the_middle_of_the_demo_leaves_no_process(tmp_path: Path, moment: str) -> None:
    with Command("demo", folder=tmp_path) as demo:
        demo.wait_for(moment)
        demo.interrupt()
        assert demo.end() == 130
        assert demo.family() == []


@pytest.mark.slow
def test_with_a_page_the_demo_waits_for_a_visitor_and_stays(tmp_path: Path) -> None:
    person, terminal = pty.openpty()
    with Command(
        "demo", "--view", folder=tmp_path, stdin=terminal, ZARM_VIEW=free_endpoint().removeprefix("tcp/")
    ) as demo:
        demo.wait_for("press Enter")
        eventually(lambda: "http://" in demo.errors(), "the page is served")
        assert "post" not in demo.output()
        os.write(person, b"\n")
        demo.wait_for("stays open")
        demo.interrupt()
        assert demo.end() == 0
        assert demo.family() == []
    os.close(person)
    os.close(terminal)
