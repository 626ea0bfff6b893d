"""A mounted tool weighs in the simulation what it weighs in plans."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from support.tools import tooled_panda
from zarm_contract.messages import Scene
from zarm_geometry.robot_model import RobotModel
from zarm_physics_sim.simulation import Simulation
from zarm_physics_sim.world import World
from zarm_planner.scene.tools import Tools


def test_tool_weighs_the_same_in_physics_and_in_plans(tmp_path: Path) -> None:
    robot = tooled_panda(tmp_path)
    home = np.array(robot.descriptor.home)
    attached = Tools.of(robot).mount(Scene(revision="0-000000000000"), "welder").attached
    plain = RobotModel.of(robot)
    bare, tooled = Simulation(robot, World(), home), Simulation(robot, World(), home, carried=attached)
    for q in (home, home + 0.3, home - 0.2):
        bare.place(q)
        tooled.place(q)
        planned = [model.dynamics for model in (plain, plain.with_attached(attached, ()))]
        without, loaded = (dynamics.holding(q[None])[0] for dynamics in planned if dynamics is not None)
        assert tooled.bias - bare.bias == pytest.approx(loaded - without, abs=1e-9)
