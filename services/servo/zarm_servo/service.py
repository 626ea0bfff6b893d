"""The servo process: wires what it knows of the world to guarding, replanning and tracking."""

from __future__ import annotations

import gc
import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from zarm_contract.errors import Busy
from zarm_contract.messages import (
    Plan,
    PlanRequest,
)
from zarm_geometry.meshes import Meshes
from zarm_geometry.robot_model import RobotModel
from zarm_runtime.mesh_folders import add_meshes
from zarm_runtime.realtime import PROCESS_PRIORITY, ask_for_realtime
from zarm_runtime.service import Service, run_service, service_parser
from zarm_servo.guarding.collision_detection import CollisionDetection
from zarm_servo.guarding.guard import Guard
from zarm_servo.guarding.replanning import Replanner
from zarm_servo.tracking.session import SessionConfig
from zarm_servo.tracking.sessions import Sessions
from zarm_servo.warm_up import warm_up
from zarm_servo.world.check import Checker, SceneCheck
from zarm_servo.world.world_monitor import WorldMonitor

log = logging.getLogger(__name__)

ANSWER = 0.2
"""Extra time (s) for an answer to arrive after the deadline of the request."""
GONE = 1.5
"""A planner that has not answered a request for a global plan this long (s) after its deadline counts as gone, and so does an executor
that has not answered one for a gripper.
"""
SWITCH_INTERVAL = 0.0005
"""Longest time (s) for which a thread reading a message may hold the interpreter while a session's cycle waits
(Python's default: 0.005).
"""


@contextmanager
def start(service: Service) -> Iterator[None]:
    """Run the servo, from its first authority to its last."""
    sys.setswitchinterval(SWITCH_INTERVAL)
    bus, keys = service.bus, service.keys
    model = RobotModel.of(service.robot)
    meshes = Meshes(service.options.meshes)
    checker, check = Checker(model, meshes), SceneCheck(model, meshes)
    warm_up(checker, check, service.starting)
    with service.open_bus() as command_bus:
        world = WorldMonitor(bus.latest(keys.joint_states), meshes, service.robot.descriptor)
        replanner = Replanner(
            service.robot,
            Checker(model, meshes),
            world,
            lambda request, deadline: bus.call(keys.plan, request, timeout=deadline + ANSWER),
            lambda request: command_bus.call(keys.replace, request, timeout=ANSWER),
            service.metrics,
        )

        def plan(request: PlanRequest, deadline: float) -> Plan:
            return bus.call(keys.plan, request, timeout=deadline + GONE)

        chunks = command_bus.publisher(keys.stream)
        sessions = Sessions(
            SessionConfig(
                service.robot,
                check,
                world,
                chunks,
                plan,
                lambda request: command_bus.call(keys.gripper, request, timeout=GONE),
                service.metrics,
                lambda: guard.wake(),
            )
        )
        detection = CollisionDetection(
            model, world.scene, command_bus.publisher(keys.external_torque).put, lambda: guard.wake()
        )
        world.on_state.append(detection.on_state)
        guard = Guard(
            service.robot.descriptor,
            checker,
            world,
            command_bus.publisher(keys.authority),
            bus.latched(keys.servo_state),
            service.instance,
            service.metrics,
            session=sessions.newest,
            validity=replanner.on_validity,
            collision_detection=lambda: detection.state,
        )
        gc.collect()
        gc.freeze()  # collecting long-lived objects again and again would delay a check
        with world.reading(bus, keys), guard, replanner:
            bus.serve(keys.servo_start, sessions.start)
            bus.serve(keys.servo_end, sessions.end)
            bus.serve(keys.joint_dynamics, detection.identify)
            command_bus.serve(keys.servo_chunk, sessions.take, workers=1)
            bus.listen(keys.object_pose("*"), world.moving.receive)
            command_bus.subscribe(keys.driver_joint_states, detection.on_joints)
            command_bus.listen(keys.servo_target, sessions.on_target)
            service.ready()
            try:
                yield
            finally:
                with suppress(Busy):
                    sessions.close()


def main() -> int:
    """Run the servo of one robot until SIGTERM or SIGINT; the exit code."""
    parser = service_parser("servo")
    add_meshes(parser)
    # As in the executor: a thread descheduled while it holds the interpreter holds up the cycles.
    ask_for_realtime(PROCESS_PRIORITY)
    return run_service("servo", parser, start)


if __name__ == "__main__":
    sys.exit(main())
