"""What RViz is told to show is what the bridge publishes."""

from __future__ import annotations

import runpy
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml

from support.paths import ROOT

ROS = ROOT / "deploy" / "ros"


def test_rviz_shows_robot_ghost_scene_and_spheres_when_late_too() -> None:
    displays = yaml.safe_load((ROS / "view.rviz").read_text())["Visualization Manager"]["Displays"]
    topics = {
        display["Name"]: topic
        for display in displays
        if (topic := display.get("Topic") or display.get("Description Topic")) is not None
    }
    assert {name: topic["Value"] for name, topic in topics.items()} == {
        "robot": "/robot_description",
        "ghost": "/preview/robot_description",
        "obstacles": "/unified_planner/obstacles",
        "collision spheres": "/unified_planner/collision_spheres",
    }
    assert {topic["Durability Policy"] for topic in topics.values()} == {"Transient Local"}
    assert next(display for display in displays if display["Name"] == "ghost")["TF Prefix"] == "preview"


class Made:
    """Whatever a launch file makes, and with what: `launch` itself is on no index of Python packages."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        self.arguments, self.options = arguments, options


@pytest.fixture
def launched(monkeypatch: pytest.MonkeyPatch) -> Callable[..., list[Made]]:
    """What the launch file starts, for these arguments of the launch."""

    class Configuration(Made):
        def perform(self, context: dict[str, str]) -> str:
            return context[self.arguments[0]]

    for name, content in {
        "launch": {"LaunchDescription": Made},
        "launch.actions": {"DeclareLaunchArgument": Made, "OpaqueFunction": Made},
        "launch.substitutions": {"LaunchConfiguration": Configuration},
        "launch_ros": {},
        "launch_ros.actions": {"Node": Made},
    }.items():
        monkeypatch.setitem(sys.modules, name, SimpleNamespace(**content))
    file = runpy.run_path(str(ROS / "view.launch.py"))

    def launch(**given: str) -> list[Made]:
        *declared, started = file["generate_launch_description"]().arguments[0]
        defaults = {one.arguments[0]: one.options["default_value"] for one in declared}
        assert set(given) <= set(defaults)
        nodes: list[Made] = started.options["function"](defaults | given)
        return nodes

    return launch


def test_the_launch_file_starts_what_shows_robot_and_ghost(launched: Callable[..., list[Made]]) -> None:
    robot, ghost, between, rviz = (node.options for node in launched())
    assert [node["executable"] for node in (robot, ghost)] == ["robot_state_publisher"] * 2
    assert (robot["namespace"], ghost["namespace"]) == ("", "/preview")
    for node in (robot, ghost):
        assert "<robot" in node["parameters"][0]["robot_description"]
    assert ghost["parameters"][0]["frame_prefix"] == "preview/"
    assert between["arguments"] == ["--frame-id", "base_link", "--child-frame-id", "preview/base_link"]
    assert Path(rviz["arguments"][1]).is_file()


def test_the_launch_file_shows_one_robot_by_namespace(launched: Callable[..., list[Made]]) -> None:
    robot, ghost, _, rviz = (node.options for node in launched(namespace="left"))
    assert (robot["namespace"], ghost["namespace"]) == ("left", "left/preview")
    assert all(shown == f"/left{topic}" for topic, shown in rviz["remappings"])
