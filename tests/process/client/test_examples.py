"""Every program of examples/, run as its README says."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import pytest

import zarm
from support.command_line import ROBOT, Up
from support.example_programs import EXAMPLES, run_example

SAYS = {
    "01_plan": "succeeded: the tool is at 0.500 0.300 0.400 m",
    "02_waypoints": "succeeded",
    "03_path_constraint": "constrained: ",
    "04_scene": "so it is refused: stale_plan",
    "05_mesh": "to spare: succeeded",
    "06_attach": "the box stands at 0.50 0.30 0.24 m",
    "07_record_and_replay": "messages published again as those of the robot echo",
    "08_speed_and_pause": "paused",
    "09_two_robots": "second: succeeded",
    "10_stream": "followed the target for 4 s, at most 0.3",
    "11_weld_seam": "succeeded",
    "12_pick_from_bin": "the part stands at 0.5",
    "13_wipe_table": "% of the way\nsucceeded",
}
ELSEWHERE = ("14_pick_and_place", "15_hand_over", "16_pick_what_a_camera_sees", "17_tray")
"""Take robots of their own: `test_pick_and_place`, `test_two_arms` and `test_perception` run them."""
"""What is in the output of each, besides success."""
OF_ITS_OWN = "09_two_robots"
"""Takes a `zarm up`."""
QUICK = ("01_plan", "10_stream")
"""What the others do, tests of the commands and of the client do as well."""


def test_there_is_a_promise_for_each_and_the_readme_lists_it() -> None:
    names = sorted(file.stem for file in EXAMPLES.glob("*.py"))
    assert names == sorted([*SAYS, *ELSEWHERE])
    readme = (EXAMPLES / "README.md").read_text()
    assert [name for name in names if f"`{name}.py`" not in readme] == []


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.slow] * (name not in QUICK)) for name in SAYS])
def test_an_example_runs_and_leaves_the_robot_at_rest(name: str, place: str, empty_scene: None, tmp_path: Path) -> None:
    with ExitStack() as stack:
        if name == OF_ITS_OWN:
            stack.enter_context(Up(place, tmp_path, joins=True, name="second"))
        assert SAYS[name] in run_example(name, place)
    with zarm.connect(place, ROBOT) as robot:
        assert robot.state().mode == "idle"
        assert robot.speed() == 1.0
        scene = robot.scene.read()
    assert (scene.objects, scene.attached) == ((), ())
