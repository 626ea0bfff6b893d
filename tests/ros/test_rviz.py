"""What RViz is told to show is what the bridge publishes."""

from __future__ import annotations

import ast

import yaml

from support.paths import ROOT

ROS = ROOT / "deploy" / "ros"


def test_the_view_shows_robot_ghost_obstacles_and_spheres_from_the_topics_of_the_bridge_for_whoever_comes_late() -> (
    None
):
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


def test_the_launch_file_is_python_that_defines_what_launch_asks_for() -> None:
    module = ast.parse((ROS / "view.launch.py").read_text())
    assert "generate_launch_description" in {node.name for node in module.body if isinstance(node, ast.FunctionDef)}
