"""The planner process: wires the planner and its scene to the bus."""

from __future__ import annotations

import gc
import logging
import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from zarm_contract.errors import Unavailable, ZarmError
from zarm_contract.key import Query
from zarm_contract.keys import Keys
from zarm_contract.messages import (
    Message,
    Plan,
    PlannerSettings,
    PlanRequest,
    ProgramRequest,
    Scene,
    SceneEdit,
    SceneEdited,
    SceneObject,
    SettingsChange,
)
from zarm_geometry.meshes import Meshes
from zarm_geometry.robot_model import RobotModel
from zarm_planner.goals.joints import MeasuredJoints
from zarm_planner.handlers import Handlers
from zarm_planner.program_changes import ProgramChanges
from zarm_planner.scene.store import SceneStore
from zarm_planner.scene.tools import Tools
from zarm_runtime.bus import Bus
from zarm_runtime.mesh_folders import add_meshes
from zarm_runtime.metrics import Metrics
from zarm_runtime.publications import Encoded
from zarm_runtime.queries import after_answer
from zarm_runtime.service import Service, run_service, service_parser
from zarm_runtime.state_file import owned

log = logging.getLogger(__name__)

Request = TypeVar("Request", bound=Message)
Reply = TypeVar("Reply", bound=Message)
Answer = TypeVar("Answer")

CAPACITY = 2 * ((os.cpu_count() or 1) + 16)
"""Requests that may be pending on each key, half of them from one client: one per core, and 16 waiting. Each has its
own thread, in which it can be cancelled while it waits.
"""

EXECUTOR_PATIENCE = 0.5
"""Longest wait (s) for the executor to tell where a moving gripper is."""
_PROGRAM = "program"
"""What programs are called in metrics, beside the names of planners."""
NEW_OBJECTS = 200_000
"""Objects allocated between two garbage collections: as many as 100,000 points and their cells, so that the collector seldom looks at a new
cloud. At Python's 700 it looks at it again and again, which takes as long as the rest of the edit. A plan leaves 10 for it."""


@contextmanager
def start(service: Service) -> Iterator[None]:
    """Run the planner, from warm-up until the last pending plan is answered."""
    with owned(service.options.state / service.keys.robot, service.name) as folder:
        robot = service.robot
        store = SceneStore(folder, Meshes(service.options.meshes), robot.urdf.links, Tools.of(robot))
        with _serving(service, store):
            yield


@contextmanager
def _serving(service: Service, store: SceneStore) -> Iterator[None]:
    bus, keys = service.bus, service.keys
    model = RobotModel.of(service.robot)
    measured = MeasuredJoints(model, bus.latest(keys.joint_states))
    handlers = Handlers(
        model,
        keys.robot,
        store,
        measured,
        bus.is_there,
        gripper_state=lambda name: bus.read(keys.gripper_state(name), timeout=EXECUTOR_PATIENCE),
        moves=lambda: _moves(bus, keys),
    )
    warm = False

    def when_warm(handler: Callable[[Request], Answer]) -> Callable[[Request], Answer]:
        def guarded(request: Request) -> Answer:
            if not warm:
                raise Unavailable(f"the planner is {service.health().activity}; ask again when its health says ready")
            return handler(request)

        return guarded

    def compute(key: Query[Request, Reply], handler: Callable[[Request], Reply | Encoded]) -> None:
        bus.serve(key, when_warm(handler), workers=CAPACITY, backlog=0, shared=True)

    plans = bus.latched(keys.plans)

    def plan(request: PlanRequest) -> Encoded:
        kind = handlers.planner_name(request)
        try:
            answer = handlers.plan(request)
        except ZarmError as error:
            _count(service.metrics, kind, error.code)
            log.info("no plan request=%s code=%s reason=%s", request.request_id or "-", error.code, error)
            raise
        if request.publish:
            encoded = plans.change(answer)
            after_answer(plans.publish)
        else:
            encoded = Encoded.of(answer)
        after_answer(lambda: _report(service.metrics, kind, request.request_id, answer))
        return encoded

    settings = bus.publisher(keys.settings)

    def change_settings(change: SettingsChange) -> PlannerSettings:
        answer = handlers.change_settings(change)
        if change != SettingsChange():
            settings.put(answer)
        return answer

    def program(request: ProgramRequest) -> Encoded:
        try:
            answer, changes = handlers.program(request)
        except ZarmError as error:
            _count(service.metrics, _PROGRAM, error.code)
            log.info("no program request=%s code=%s reason=%s", request.request_id or "-", error.code, error)
            raise
        if request.publish:
            program_changes.remember(answer.plan_id, answer.trajectory.duration, changes)
            encoded = plans.change(answer)
            after_answer(plans.publish)
        else:
            encoded = Encoded.of(answer)
        after_answer(lambda: _report(service.metrics, _PROGRAM, request.request_id, answer))
        return encoded

    try:
        program_changes = ProgramChanges(_serve_scene(service, store.scene, handlers.edit, store.notes))
        bus.subscribe(keys.object_pose("*"), handlers.scenes.moved.receive)
        bus.watch(keys.voxels("*"), handlers.scenes.voxels.receive)
        bus.watch(keys.perception_state, handlers.scenes.voxels.on_state)
        bus.watch(keys.perception_state, handlers.map_health.receive)
        bus.watch(keys.gripper_state("*"), handlers.grippers.receive)
        bus.serve(keys.settings, change_settings, workers=1)
        bus.latched(keys.planners).set(handlers.planners())
        bus.serve(keys.plan_cancel, handlers.cancel)
        bus.serve(keys.fk, when_warm(handlers.fk))
        bus.serve(keys.inverse_dynamics, when_warm(handlers.inverse_dynamics))
        compute(keys.plan, plan)
        compute(keys.program, program)
        bus.watch(keys.goal("*"), program_changes.receive)
        compute(keys.ik, handlers.ik)
        compute(keys.check, handlers.check)
        compute(keys.occupancy, handlers.occupancy)
        bus.watch_clients(handlers.leave)
        handlers.warm_up(service.starting)
        gc.freeze()  # collecting loaded objects again and again would at times delay a plan by 0.1 s
        gc.set_threshold(NEW_OBJECTS)
        warm = True
        service.ready()
        yield
    finally:
        handlers.close()


def _moves(bus: Bus, keys: Keys) -> bool:
    """Whether the executor has a motion; without one nothing moves the robot."""
    try:
        return bus.read(keys.executor_state, timeout=EXECUTOR_PATIENCE).mode not in ("idle", "fault")
    except Unavailable:
        return False


def _report(metrics: Metrics, kind: str, request_id: str | None, answer: Plan) -> None:
    _count(metrics, kind, "ok")
    metrics.time("zarm_planning_seconds", "How long successful plans took.", answer.timings.total, planner=kind)
    log.info(
        "planned request=%s plan=%s seconds=%.3f clearance=%.4f duration=%.2f",
        request_id or "-",
        answer.plan_id,
        answer.timings.total,
        answer.clearance,
        answer.trajectory.duration,
    )


def _count(metrics: Metrics, kind: str, outcome: str) -> None:
    metrics.count(
        "zarm_plans", "Plans requested; outcome is ok or the code of the problem.", planner=kind, outcome=outcome
    )


def _serve_scene(
    service: Service,
    now: Scene,
    change: Callable[[SceneEdit], Scene],
    notes: Callable[[SceneEdit], tuple[str, ...]],
) -> Callable[[SceneEdit], SceneEdited]:
    """Serve the scene, initially `now`, and its objects; apply requested edits with `change`, and publish every change.
    Returns a function that does the same for this process.

    `notes` returns remarks on what an edit has added.
    """
    bus, keys = service.bus, service.keys
    revision = bus.latched(keys.scene_revision)
    whole = bus.latched(keys.scene)
    single = bus.latched(keys.scene_object("*"))
    shown: tuple[SceneObject, ...] = ()
    one_at_a_time = threading.Lock()

    def show(scene: Scene) -> SceneEdited:
        nonlocal shown
        answer = SceneEdited(revision=scene.revision, count=len(scene.objects))
        revision.set(answer)
        before = {item.name: item for item in shown}
        changed = [item for item in scene.objects if before.pop(item.name, None) != item]
        # By itself an object counts in every collision, so one that may be touched comes after the scene that says so.
        touchable = {*scene.ignored_objects, *(name for pair in scene.ignored_pairs for name in pair)}
        for item in changed:
            if item.name not in touchable:
                single.set(item, key=keys.scene_object(item.name))
        for name in before:
            single.forget(keys.scene_object(name))
        whole.set(scene)
        for item in changed:
            if item.name in touchable:
                single.set(item, key=keys.scene_object(item.name))
        shown = scene.objects
        return answer

    def edit(request: SceneEdit) -> SceneEdited:
        with one_at_a_time:
            edited = show(change(request))
        return edited.model_copy(update={"notes": notes(request)})

    show(now)
    bus.serve(keys.scene_edit, edit, workers=1)
    return edit


def main() -> int:
    """Run the planner of one robot until SIGTERM or SIGINT; the exit code."""
    parser = service_parser("planner")
    add_meshes(parser)
    return run_service("planner", parser, start)


if __name__ == "__main__":
    sys.exit(main())
