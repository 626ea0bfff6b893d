"""What the executor does where the scene changes, or a client thinks better of it, while it looks at the scene."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import pytest

from support.arrivals import arrival
from support.executor.bench import EXECUTION, Bench
from support.trajectories import KEYS, ROBOT, SCENE, moved, rest_to_rest
from zarm_contract.errors import ExecutionRefused, Unavailable
from zarm_contract.messages import ExecuteRequest, GoalState, JointState, Nothing, Plan, SceneEdited, Speed
from zarm_executor.admission import Admission
from zarm_executor.executor import Executor
from zarm_executor.grippers import Grippers
from zarm_executor.outputs import Outputs
from zarm_executor.plans import Plans
from zarm_executor.reporter import Reporter
from zarm_executor.scene import PresentScene
from zarm_runtime.bus import Bus
from zarm_runtime.metrics import Metrics
from zarm_runtime.state_file import StateFile


def unanswered() -> Plan:
    raise Unavailable("no planner")


def executor_of(bench: Bench, bus: Bus, folder: Path, scene: Callable[[], SceneEdited]) -> Executor:
    reporter = Reporter(
        bus,
        KEYS,
        ROBOT.descriptor.joints,
        bench.machine,
        StateFile(folder / "running_goal.json", GoalState),
        lambda: 0.0,
        lambda _: None,
        Metrics(),
    )
    return Executor(
        ROBOT,
        bench.machine,
        reporter,
        Admission(bench.machine, reporter, EXECUTION.joint_state_timeout),
        Plans(ROBOT.hash, unanswered),
        PresentScene(bench.machine, scene),
        {},
        bus.publisher(KEYS.strategy),
        bus.publisher(KEYS.speed),
        StateFile(folder / "speed.json", Speed),
        Grippers(ROBOT, bench.machine, bus, KEYS, StateFile(folder / "grippers.json", JointState)),
        Outputs(ROBOT, "emulator", bus, KEYS),
    )


def test_a_preempting_goal_is_refused_after_a_scene_edit(bus: Bus, tmp_path: Path) -> None:
    answers = iter((SCENE, "2-0123456789ab"))
    bench = Bench(now=float("inf"))  # fresh, though nobody ticks
    executor = executor_of(bench, bus, tmp_path, lambda: SceneEdited(revision=next(answers), count=0))
    request = ExecuteRequest(trajectory=rest_to_rest(moved(0.5)), scene_revision=SCENE, preempt=True)
    with pytest.raises(ExecutionRefused) as refusal:
        executor.execute(request, arrival())
    assert refusal.value.code == "stale_plan"
    assert bench.machine.state().mode == "idle"


def test_a_pause_wins_over_a_resume_that_checks_the_scene(bus: Bus, tmp_path: Path) -> None:
    def look() -> SceneEdited:
        executor.pause(Nothing(), arrival())
        return SceneEdited(revision=SCENE, count=0)

    bench = Bench(now=time.monotonic() + 3600.0)  # here just now, though it ticks only when told to
    executor = executor_of(bench, bus, tmp_path, look)
    bench.execute(scene=SCENE)
    bench.run(0.3)
    bench.machine.pause(arrival())
    bench.until("paused")
    executor.resume(Nothing(), arrival())
    assert bench.machine.state().mode == "paused"
