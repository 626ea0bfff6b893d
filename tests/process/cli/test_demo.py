"""`zarm demo`: it runs anywhere, any number of times, and leaves nothing behind."""

from __future__ import annotations

from pathlib import Path

import pytest

from support.command_line import Command
from support.harness import eventually


def test_two_demos_at_once_plan_around_the_post_and_reach_their_goals(tmp_path: Path) -> None:
    with Command("demo", folder=tmp_path) as one, Command("demo", folder=tmp_path) as other:
        for demo in (one, other):
            assert demo.end() == 0, demo.errors()
            assert "post" in demo.output()
            assert "clearance" in demo.output()
            assert "succeeded" in demo.output()
            assert demo.family() == []
            assert demo.errors() == ""


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
