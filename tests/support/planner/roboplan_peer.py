"""RoboPlan's RRT-Connect and shortcutting with the robot as the same spheres; it checks collisions itself, with coal."""

from __future__ import annotations

import time
from itertools import combinations
from xml.etree import ElementTree as ET

import numpy as np
from roboplan import core, rrt

from support.planner.ompl_peer import STEP, Run
from zarm_contract.messages import Cuboid, SceneObject
from zarm_geometry.frames import matrix
from zarm_geometry.robot_model import RobotModel
from zarm_trajectory.arrays import Array


def scene(model: RobotModel, objects: tuple[SceneObject, ...]) -> core.Scene:
    """The robot, and boxes and cylinders around it."""
    scene = core.Scene("problem", core.loadUrdfSceneDescriptionFromXml(_urdf(model)))
    scene.addGroup("arm", model.robot.descriptor.joints)
    for item in objects:
        pose, color = np.asfortranarray(matrix(item.position, item.orientation)), np.ones(4)
        if isinstance(item, Cuboid):
            scene.addBoxGeometry(item.name, "universe", core.Box(*item.size), pose, color)
        else:
            scene.addCylinderGeometry(item.name, "universe", core.Cylinder(item.radius, item.length), pose, color)
    fixed = [link for link, joint in zip(model.links, model.link_joint, strict=True) if joint < 0]
    ignored = [*combinations((*fixed, *(item.name for item in objects)), 2), *combinations(model.links, 2)]
    meeting = {frozenset((model.links[a], model.links[b])) for a, b in model.pairs}
    scene.setCollisions([pair for pair in ignored if frozenset(pair) not in meeting], False)
    return scene


def plan(scene: core.Scene, model: RobotModel, start: Array, goal: Array, timeout: float, seed: int) -> Run | None:
    """One search from `start` to `goal` (dof,) and the shortcutting of its path; None if it found none in time."""
    options = rrt.RRTOptions(
        group_name="arm",
        max_nodes=1_000_000,
        collision_check_step_size=STEP,
        max_planning_time=timeout,
        rrt_connect=True,
    )
    planner = rrt.RRT(scene, options)
    planner.setRngSeed(seed)
    names = model.robot.descriptor.joints
    ends = [core.JointConfiguration(names, q) for q in (start, goal)]
    shortcuts = core.PathShortcutter(
        scene, core.PathShortcuttingOptions(group_name="arm", max_step_size=STEP, seed=seed)
    )
    began = time.thread_time()
    try:
        path = planner.plan(*ends)
    except RuntimeError:
        return None
    searched = time.thread_time()
    rows = np.array(shortcuts.shortcut(path).positions)
    done = time.thread_time()
    return Run(searched - began, done - searched, float(np.linalg.norm(np.diff(rows, axis=0), axis=1).sum()))


def _urdf(model: RobotModel) -> str:
    root = ET.parse(model.robot.urdf_path).getroot()
    for link in root.iter("link"):
        for ball in model.robot.descriptor.spheres.get(link.attrib["name"], ()):
            collision = ET.SubElement(link, "collision")
            ET.SubElement(collision, "origin", xyz=" ".join(map(repr, ball.center)))
            ET.SubElement(ET.SubElement(collision, "geometry"), "sphere", radius=repr(ball.radius))
    return ET.tostring(root, encoding="unicode")
