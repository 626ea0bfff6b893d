"""The interface of the node `unified_planner`, with all that clients of curobo_ros find there."""

from __future__ import annotations

from collections.abc import Iterator, MutableMapping
from contextlib import contextmanager

from zarm_ros_bridge.action_servers import ActionServers
from zarm_ros_bridge.convert.colours import Colour
from zarm_ros_bridge.curobo.additions import Additions
from zarm_ros_bridge.curobo.availability import Availability
from zarm_ros_bridge.curobo.execution import ExecutionActions
from zarm_ros_bridge.curobo.generations.generation import Generation
from zarm_ros_bridge.curobo.kinematics import Kinematics
from zarm_ros_bridge.curobo.motions import Motions
from zarm_ros_bridge.curobo.parameters import Parameters
from zarm_ros_bridge.curobo.planning import Planning
from zarm_ros_bridge.curobo.scene import SceneServices
from zarm_ros_bridge.curobo.strategies import StrategyServices
from zarm_ros_bridge.curobo.world_file import WorldFile
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.ros import Ros
from zarm_ros_bridge.topics import Topics
from zarm_ros_bridge.turns import Turns


@contextmanager
def unified_planner(
    ros: Ros,
    first: Ros,
    engine: Engine,
    parameters: Parameters,
    generation: Generation,
    topics: Topics,
    servers: ActionServers,
    turns: Turns,
    colours: MutableMapping[str, Colour],
) -> Iterator[None]:
    """Serve on the node of `ros`; call before `spin`. `first` is the node that serves `set_robot_strategy` by its first type."""
    motions = Motions(engine, parameters)
    Planning(ros, engine, parameters, motions, generation)
    Kinematics(ros, engine, generation)
    SceneServices(ros, engine, parameters, colours, generation)
    WorldFile(engine, parameters)
    ExecutionActions(ros, engine, parameters, motions, generation, servers, turns)
    if generation.additions:
        Additions(ros, engine, motions, topics.show_spheres)
    else:
        topics.show_spheres(True)
    with StrategyServices(ros, first, engine, parameters, generation), Availability(engine, parameters):
        yield
