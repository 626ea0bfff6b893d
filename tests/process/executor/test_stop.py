"""A stop reaches also what has not begun to move."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from support.arrivals import arrival
from support.executor.bench import EXECUTION, Bench
from support.harness import PATIENCE
from support.trajectories import KEYS, ROBOT, SCENE, moved, plan, rest_to_rest
from zarm_contract.errors import Busy, Cancelled, Unavailable
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


def test_a_stop_withdraws_what_is_being_checked(bus: Bus, tmp_path: Path) -> None:
    asked, go_on = threading.Event(), threading.Event()

    def newest() -> Plan:
        asked.set()
        assert go_on.wait(PATIENCE)
        return plan("slow", rest_to_rest(moved(0.5)))

    def unanswered() -> SceneEdited:
        raise Unavailable("no planner")

    bench = Bench(now=float("inf"))  # fresh, though nobody ticks
    bench.machine.scene = SCENE
    reporter = Reporter(
        bus,
        KEYS,
        ROBOT.descriptor.joints,
        bench.machine,
        StateFile(tmp_path / "running_goal.json", GoalState),
        lambda: 0.0,
        lambda _: None,
        Metrics(),
    )
    plans = Plans(ROBOT.hash, newest)
    executor = Executor(
        ROBOT,
        bench.machine,
        reporter,
        Admission(bench.machine, reporter, EXECUTION.joint_state_timeout),
        plans,
        PresentScene(bench.machine, unanswered),
        {},
        bus.publisher(KEYS.strategy),
        bus.publisher(KEYS.speed),
        StateFile(tmp_path / "speed.json", Speed),
        Grippers(ROBOT, bench.machine, bus, KEYS, StateFile(tmp_path / "grippers.json", JointState)),
        Outputs(ROBOT, "emulator", bus, KEYS),
    )
    with ThreadPoolExecutor(1) as pool:
        first = pool.submit(executor.execute, ExecuteRequest(), arrival())
        try:
            assert asked.wait(PATIENCE)
            with pytest.raises(Busy):
                executor.execute(ExecuteRequest(), arrival())
            executor.stop(Nothing(), arrival())
        finally:
            go_on.set()
        with pytest.raises(Cancelled):
            first.result(PATIENCE)
    assert bench.machine.state().mode == "idle"
