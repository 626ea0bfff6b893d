"""The servo process: wires the guard and its copy of the scene to the bus."""

from __future__ import annotations

import gc
import logging
import os
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from zarm_contract.messages import (
    Authority,
    ExecutorState,
    GoalState,
    GoalTrajectory,
    JointState,
    Message,
    Scene,
    SceneObject,
    ServoState,
)
from zarm_geometry.meshes import Meshes
from zarm_geometry.robot_model import RobotModel
from zarm_runtime.service import Service, run_service, service_parser
from zarm_servo.check import Checker
from zarm_servo.guard import Guard
from zarm_servo.warm_up import warm_up

log = logging.getLogger(__name__)

PLANNER_PERIOD = 1.0
"""How often (s) the servo looks whether there is a planner."""
_OBJECT: TypeAdapter[SceneObject] = TypeAdapter(SceneObject)


@contextmanager
def start(service: Service) -> Iterator[None]:
    """The servo, from its first authority to its last."""
    bus, keys = service.bus, service.keys
    model = RobotModel.of(service.robot)
    checker = Checker(model, Meshes(service.options.meshes))
    service.starting("loading the check of motions")
    warm_up(model, checker)
    with service.open_bus() as command_bus:
        guard = Guard(
            service.robot.descriptor.joints,
            checker,
            bus.latest(keys.joint_states, JointState),
            command_bus.publisher(keys.authority, Authority, realtime=True),
            bus.latched(keys.servo_state, ServoState),
            service.instance,
            service.metrics,
        )

        def receive(key: str, payload: bytes) -> None:
            try:
                guard.mirror.hear_object(_OBJECT.validate_json(payload[: Message.max_bytes]), time.monotonic())
            except ValidationError as error:
                log.warning("dropped a message key=%s reason=%s", key, error.errors()[0]["msg"])

        bus.watch(keys.scene, Scene, guard.mirror.hear_scene)
        bus.listen(keys.scene_object("*"), receive)
        bus.watch(keys.executor_state, ExecutorState, guard.hear_state)
        bus.watch(keys.goal("*"), GoalState, guard.hear_goal)
        bus.watch(keys.goal_trajectory, GoalTrajectory, guard.hear_trajectory)
        ended = threading.Event()

        def look_for_planner() -> None:
            while not ended.wait(PLANNER_PERIOD):
                guard.hear_planner(gone=not bus.alive(keys.alive("planner", "*"), timeout=PLANNER_PERIOD))

        looking = threading.Thread(target=look_for_planner, name="planner", daemon=True)
        looking.start()
        gc.collect()
        gc.freeze()  # to look for garbage in what stays, again and again, would delay a check
        with guard:
            service.ready()
            try:
                yield
            finally:
                ended.set()
                looking.join()


def main() -> int:
    """Run the servo of one robot until SIGTERM or SIGINT; the exit code."""
    parser = service_parser("servo")
    parser.add_argument(
        "--meshes",
        type=Path,
        action="append",
        default=[Path(folder) for folder in os.environ.get("ZARM_MESHES", "").split(os.pathsep) if folder],
        metavar="FOLDER",
        help="a folder whose mesh files the scene may use, besides those in $ZARM_MESHES: those of the planner; repeatable",
    )
    return run_service("servo", parser, start)


if __name__ == "__main__":
    sys.exit(main())
