"""The process of the ROS bridge: one participant pair for each robot, and what it serves there."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

from zarm_contract.errors import InvalidRequest
from zarm_ros_bridge.action_servers import ActionServers
from zarm_ros_bridge.cameras import CameraTopics
from zarm_ros_bridge.convert.colours import Colour
from zarm_ros_bridge.curobo.generations.installed import installed
from zarm_ros_bridge.curobo.parameters import Parameters
from zarm_ros_bridge.curobo.unified_planner import unified_planner
from zarm_ros_bridge.diagnostics import Diagnostics
from zarm_ros_bridge.drivers.robot_driver import Drivers
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.faults import Faults
from zarm_ros_bridge.frames import Frames
from zarm_ros_bridge.grippers import Grippers
from zarm_ros_bridge.moveit.move_group import NODE as MOVE_GROUP
from zarm_ros_bridge.moveit.move_group import WORKERS as MOVE_GROUP_WORKERS
from zarm_ros_bridge.moveit.move_group import move_group
from zarm_ros_bridge.replies import insist
from zarm_ros_bridge.ros import Ros
from zarm_ros_bridge.ros2_control.controller_topics import ControllerTopics
from zarm_ros_bridge.ros2_control.gripper_actions import GripperActions
from zarm_ros_bridge.ros2_control.trajectory_action import TrajectoryAction
from zarm_ros_bridge.servo_commands import ServoCommands
from zarm_ros_bridge.terms import Terms
from zarm_ros_bridge.topics import Topics
from zarm_ros_bridge.transform_publisher import TransformPublisher
from zarm_ros_bridge.turns import Turns
from zarm_runtime import clock
from zarm_runtime.service import Service, run_service, service_parser

NODE = "unified_planner"
"""The name of the node, as clients of the reference know it."""
WORKERS = 16
"""Number of requests handled at once; further ones wait."""


@contextmanager
def start(service: Service) -> Iterator[None]:
    """The node of one robot, and the second one that serves `set_robot_strategy` by its first type."""
    namespace = _namespace(service)
    generation = installed()
    service.note = str(generation)
    if clock.speed != 1.0:
        raise InvalidRequest("ROS 2 runs in real time; start the bridge without ZARM_SIM_SPEED", field="ZARM_SIM_SPEED")
    with (
        Ros(NODE, namespace, workers=WORKERS, parameters=True) as ros,
        Ros(f"_{NODE}_v1", namespace, workers=2) as first,
        _participants(service, namespace) as (moveit, controller),
        service.open_bus() as bus,  # closed before the nodes, which its messages need
        ExitStack() as listening,  # likewise, before the bus that the driver's messages need
    ):
        participants = [one for one in (ros, first, moveit, controller) if one is not None]
        for one in participants:
            listening.callback(one.stop_listening)
        params = service.robot.descriptor.strategy_params
        engine = Engine(
            bus, service.keys, service.robot, Terms(ros.node.get_fully_qualified_name(), service.keys, params)
        )
        parameters = Parameters(ros.node, engine)
        turns = Turns(engine, lambda: bool(parameters.value("preempt")))
        colours: dict[str, Colour] = {}
        grippers = Grippers(engine)
        frames = Frames(ros, engine, grippers)
        Faults(ros, engine)
        if params is not None:
            Drivers(ros, controller, engine, params)
        CameraTopics(ros, engine)
        obstacles = ("~/obstacles", "~/scene_obstacles")[: 1 + generation.additions]
        with (
            Topics(ros, engine, grippers, colours, obstacles=obstacles) as topics,
            ActionServers(engine, turns) as servers,
            ServoCommands(ros, first, engine, frames) as servo_commands,
            Diagnostics(ros, engine),
            TransformPublisher(ros, engine, frames),
            ControllerTopics(ros, engine, frames),
            ExitStack() as serving,
        ):
            serving.enter_context(
                unified_planner(ros, first, engine, parameters, generation, topics, servers, turns, colours)
            )
            TrajectoryAction(ros, engine, frames, servers)
            GripperActions(ros, engine, servers)
            if moveit is not None:
                serving.enter_context(
                    move_group(moveit, engine, frames, servers, turns, colours, servo_commands, service.options.group)
                )
            for one in participants:
                one.spin()
            servers.take_up_goals()
            service.ready()
            yield


@contextmanager
def _participants(service: Service, namespace: str) -> Iterator[tuple[Ros | None, Ros | None]]:
    """The participants of MoveIt's interface, and of the client of a controller's action, where these are wanted."""
    params = service.robot.descriptor.strategy_params
    with ExitStack() as stack:
        moveit = controller = None
        if service.options.moveit:
            moveit = stack.enter_context(Ros(MOVE_GROUP, namespace, workers=MOVE_GROUP_WORKERS, parameters=True))
        descriptor = service.robot.descriptor
        actions = [gripper.action for gripper in descriptor.grippers.values()]
        services = [output.service for output in descriptor.outputs.values()]
        if params is not None and any((params.action, *actions, *services)):
            controller = stack.enter_context(Ros(f"_{NODE}_controller", namespace, workers=0))
        yield moveit, controller


def _namespace(service: Service) -> str:
    """The reference's names for a single robot, or names under the robot's own if there are several."""
    given: str | None = service.options.namespace
    several = len(service.options.robot) > 1
    if given is not None and several:
        raise InvalidRequest("several robots have their names as namespaces; leave it out", field="--namespace")
    return service.keys.robot if several else given or ""


def main() -> int:
    """Bridge one robot or several until SIGTERM or SIGINT; the exit code."""
    parser = service_parser("ros_bridge", several=True)
    parser.add_argument(
        "--namespace", help="the ROS namespace (default: none for one robot, the name of each robot for several)"
    )
    parser.add_argument(
        "--moveit",
        action="store_true",
        help="serve the interface of MoveIt's move_group as well, to its clients and RViz",
    )
    parser.add_argument(
        "--group", default="arm", help="the name of the planning group that clients of MoveIt give (default: arm)"
    )
    insist()
    return run_service("ros_bridge", parser, start)


if __name__ == "__main__":
    sys.exit(main())
