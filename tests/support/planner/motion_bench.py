"""MotionBenchMaker's problems and robots from ../shared, as zarm's own models."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import yaml

from support.paths import SHARED
from zarm_contract.messages import Cuboid, Cylinder, Pose, SceneObject
from zarm_contract.robot import RobotDescription, load_robot

PROBLEMS = SHARED / "mbm"
AVAILABLE = PROBLEMS.is_dir()
ROBOTS = ("panda", "ur5")
SCENES = ("bookshelf_small", "table_pick", "box")


@dataclass(frozen=True)
class Problem:
    """A start and goals in joint space, the poses of the goals, and the objects in between."""

    index: int
    start: tuple[float, ...]
    goals: tuple[tuple[float, ...], ...]
    goal_poses: tuple[Pose, ...]
    objects: tuple[SceneObject, ...]


def robot(name: str, folder: Path) -> RobotDescription:
    """MotionBenchMaker's `panda` or `ur5`, from a URDF and a descriptor written into `folder`.

    Its spheres are also its exact geometry.
    """
    data = json.loads((PROBLEMS / "robots" / f"{name}.json").read_text())
    (folder / f"{name}.urdf").write_text(_urdf(data))
    path = folder / f"{name}.yaml"
    path.write_text(yaml.safe_dump(_descriptor(data)))
    return load_robot(str(path))


def problems(robot_name: str, scene: str) -> list[Problem]:
    """The problems of one robot and scene whose start and goal are free."""
    data = json.loads((PROBLEMS / f"{robot_name}_{scene}.json").read_text())
    return [
        Problem(
            index=problem["index"],
            start=tuple(problem["start"]),
            goals=tuple(tuple(goal) for goal in problem["goals"]),
            goal_poses=tuple(
                Pose(position=tuple(pose["position"]), orientation=tuple(pose["quaternion_xyzw"]))
                for pose in problem["goal_poses"]
            ),
            objects=tuple(_object(obstacle) for obstacle in problem["obstacles"]),
        )
        for problem in data["problems"]
        if problem["valid"]
    ]


def _object(data: dict[str, Any]) -> SceneObject:
    place = {"name": data["name"], "position": tuple(data["position"]), "orientation": tuple(data["quaternion_xyzw"])}
    if data["type"] == "box":
        return Cuboid(kind="cuboid", size=tuple(data["size"]), **place)
    return Cylinder(kind="cylinder", radius=data["radius"], length=data["length"], **place)


def _urdf(data: dict[str, Any]) -> str:
    links = {data["base_link"], *(joint["child"] for joint in data["joints"])}
    parts = [f"<link name={quoteattr(link)}/>" for link in sorted(links)]
    for joint in data["joints"]:
        numbers = {key: " ".join(map(repr, joint[key])) for key in ("origin_xyz", "origin_rpy")}
        motion = ""
        if joint["type"] != "fixed":
            axis = " ".join(map(repr, joint["axis"]))
            motion = f'<axis xyz="{axis}"/><limit lower="{joint["lower"]}" upper="{joint["upper"]}" velocity="1" effort="1"/>'
        parts.append(
            f'<joint name="{joint["name"]}" type="{joint["type"]}"><parent link="{joint["parent"]}"/>'
            f'<child link="{joint["child"]}"/><origin xyz="{numbers["origin_xyz"]}" rpy="{numbers["origin_rpy"]}"/>'
            f"{motion}</joint>"
        )
    return f'<robot name="{data["name"]}">{"".join(parts)}</robot>'


def _descriptor(data: dict[str, Any]) -> dict[str, Any]:
    limits = data["planning_limits"]
    names = list(data["spheres"])
    free = {frozenset(pair) for pair in data["self_collision_pairs"]}
    ignore = [[a, b] for i, a in enumerate(names) for b in names[i + 1 :] if frozenset((a, b)) not in free]
    balls = {
        link: [{"kind": "sphere", "center": ball[:3], "radius": ball[3]} for ball in spheres]
        for link, spheres in data["spheres"].items()
    }
    middle = [(low + high) / 2 for low, high in zip(data["lower"], data["upper"], strict=True)]
    return {
        "name": data["name"],
        "urdf": f"{data['name']}.urdf",
        "base_link": data["base_link"],
        "tip_link": data["end_effector_link"],
        "joints": data["joint_names"],
        "home": middle,
        "cspace": {key: limits[key] for key in ("velocity", "acceleration")}
        | {"jerk": limits.get("jerk") or [500.0] * len(data["joint_names"])},
        "spheres": {
            link: [{key: ball[key] for key in ("center", "radius")} for ball in b] for link, b in balls.items()
        },
        "collision": balls,
        "self_collision_ignore": ignore,
    }
