"""The servo process: wires the guard, the sessions and their copy of the scene to the bus."""

from __future__ import annotations

import gc
import logging
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from pydantic import TypeAdapter, ValidationError

from zarm_contract.errors import Busy
from zarm_contract.messages import (
    Message,
    Plan,
    PlanRequest,
    SceneObject,
)
from zarm_geometry.meshes import Meshes
from zarm_geometry.robot_model import RobotModel
from zarm_runtime.mesh_folders import add_meshes
from zarm_runtime.realtime import PROCESS_PRIORITY, ask_for_realtime
from zarm_runtime.service import Service, run_service, service_parser
from zarm_servo.check import Checker, SceneCheck
from zarm_servo.guard import Guard
from zarm_servo.replanning import Replanner
from zarm_servo.sessions import Sessions
from zarm_servo.warm_up import warm_up

log = logging.getLogger(__name__)

PLANNER_PERIOD = 1.0
"""Interval (s) at which the servo checks that there is a planner."""
MISSED = 2
"""A planner counts as gone after so many checks: on a busy machine the answer to one may come too late."""
ANSWER = 0.2
"""Extra time (s) for an answer to arrive after the deadline of the request."""
GONE = 1.5
"""A planner that has not answered a request for a global plan this long (s) after its deadline counts as gone."""
SWITCH_INTERVAL = 0.0005
"""Longest time (s) for which a thread reading a message may hold the interpreter while a session's cycle waits
(Python's default: 0.005).
"""
_OBJECT: TypeAdapter[SceneObject] = TypeAdapter(SceneObject)


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
        measured = bus.latest(keys.joint_states)
        guard = Guard(
            service.robot.descriptor,
            checker,
            meshes,
            measured,
            command_bus.publisher(keys.authority),
            bus.latched(keys.servo_state),
            service.instance,
            service.metrics,
        )
        guard.replanner = replanner = Replanner(
            service.robot,
            Checker(model, meshes),
            guard.monitor,
            guard.moving,
            measured,
            lambda request, deadline: bus.call(keys.plan, request, timeout=deadline + ANSWER),
            lambda request: command_bus.call(keys.replace, request, timeout=ANSWER),
            service.metrics,
        )
        chunks = command_bus.publisher(keys.stream)

        def plan(request: PlanRequest, deadline: float) -> Plan:
            return bus.call(keys.plan, request, timeout=deadline + GONE)

        sessions = Sessions(service.robot, check, guard, measured, chunks, plan, service.metrics)

        def receive(key: str, payload: bytes) -> None:
            try:
                guard.monitor.on_object(_OBJECT.validate_json(payload[: Message.max_bytes]), time.monotonic())
            except ValidationError as error:
                log.warning("dropped a message key=%s reason=%s", key, error.errors()[0]["msg"])

        bus.watch(keys.scene, guard.monitor.on_scene)
        bus.listen(keys.scene_object("*"), receive)
        for on_state in (guard.on_state, sessions.on_state, replanner.on_state):
            bus.watch(keys.executor_state, on_state)
        for on_goal in (guard.on_goal, sessions.on_goal, replanner.on_goal):
            bus.watch(keys.goal("*"), on_goal)
        bus.watch(keys.goal_trajectory, guard.on_trajectory)
        ended = threading.Event()

        def look_for_planner() -> None:
            missed = 0
            while not ended.wait(PLANNER_PERIOD):
                alive = bus.alive(keys.alive("planner", "*"), timeout=PLANNER_PERIOD)
                missed = 0 if alive else missed + 1
                guard.on_planner(gone=missed >= MISSED)

        looking = threading.Thread(target=look_for_planner, name="planner", daemon=True)
        looking.start()
        gc.collect()
        gc.freeze()  # collecting long-lived objects again and again would delay a check
        with guard, replanner:
            bus.serve(keys.servo_start, sessions.start)
            bus.serve(keys.servo_end, sessions.end)
            bus.listen(keys.object_pose("*"), guard.moving.receive)
            command_bus.listen(keys.servo_target, sessions.on_target)
            service.ready()
            try:
                yield
            finally:
                with suppress(Busy):
                    sessions.close()
                ended.set()
                looking.join()


def main() -> int:
    """Run the servo of one robot until SIGTERM or SIGINT; the exit code."""
    parser = service_parser("servo")
    add_meshes(parser)
    # As in the executor: a thread descheduled while it holds the interpreter holds up the cycles.
    ask_for_realtime(PROCESS_PRIORITY)
    return run_service("servo", parser, start)


if __name__ == "__main__":
    sys.exit(main())
