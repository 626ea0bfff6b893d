"""Whatever bytes arrive on whatever key: every service stays up and answers, nothing moves, nothing grows, good requests work.

`ZARM_FUZZ` is how many random payloads each of these tests sends; the same number sends the same payloads.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
import psutil
import pytest
import zenoh

from support.executor.driven import driven
from support.faults import payloads
from support.harness import PATIENCE, ServiceProcess, eventually
from support.message_examples import by_class
from support.resources import favour
from support.trajectories import HOME, KEYS, ROBOT, moved, plan, rest_to_rest, rows
from zarm_contract import messages as m
from zarm_contract.codec import decode
from zarm_contract.errors import InvalidRequest, Problem
from zarm_contract.image import encode_image
from zarm_contract.messages import Message
from zarm_runtime.bus import Bus
from zarm_runtime.session import open_client

pytestmark = pytest.mark.slow

COUNT = int(os.environ.get("ZARM_FUZZ", "2000"))
SEED = 1
CLIENTS = 16
SMALL = {"width": 64, "height": 48, "fx": 100.0, "fy": 100.0, "cx": 31.5, "cy": 23.5}
JOINTS = ROBOT.descriptor.joints
ASIDE = rest_to_rest(moved(*[1.0] * 6), moved(*[0.5] * 6), dt=0.2)
"""A motion that the robot could make, but from half a radian beside where it stands: whatever it is turned into, the robot
is not at its start."""
GROWTH = 64 * 2**20
"""How much larger, in bytes, a process may be after all than after the first tenth, which fills caches and pools."""

POOLS = 20
"""How many threads may have been started since then: each key has two, which are started when they are needed."""


@dataclass(frozen=True)
class Ear:
    """A key that a service listens to: `query` and its request, `publication` and its message, or a `latched` value."""

    key: str
    model: type[Message]
    kind: str = "query"
    more: tuple[Message, ...] = ()

    @property
    def examples(self) -> list[Message]:
        return [*by_class()[self.model], *self.more]


EXECUTOR = (
    Ear(KEYS.execute, m.ExecuteRequest, more=(m.ExecuteRequest(), m.ExecuteRequest(trajectory=ASIDE))),
    Ear(KEYS.cancel, m.CancelRequest),
    Ear(KEYS.strategy, m.StrategyRequest),
    *(Ear(key, m.Nothing) for key in (KEYS.stop, KEYS.pause, KEYS.resume, KEYS.reset, KEYS.health("executor"))),
    Ear(KEYS.executor_state, m.Nothing, "latched"),
    Ear(KEYS.goal("goal-1"), m.Nothing, "latched"),
    Ear(KEYS.plans, m.Plan, "publication", (plan("plan-2", ASIDE),)),
    Ear(KEYS.scene_revision, m.SceneEdited, "publication"),
    Ear(KEYS.driver_progress, m.DriverProgress, "publication"),
    Ear(
        KEYS.driver_joint_states,
        m.JointState,
        "publication",
        (m.JointState(stamp=1.75e9, joint_names=JOINTS[::-1], position=(0.5,) * 6, velocity=(0.0,) * 6),),
    ),
)
DRIVER = (
    Ear(
        KEYS.driver_command,
        m.DriverCommand,
        "publication",
        (
            m.DriverCommand(
                sequence=1,
                joint_names=JOINTS,
                based_on=1.75e9,
                expires_after=0.1,
                time=(0.0, 0.02),
                position=((0.0,) * 6,) * 2,
                velocity=((0.3,) * 6,) * 2,
            ),
        ),
    ),
    Ear(KEYS.simulated_fault, m.DriverFault, more=(m.DriverFault(),)),
    Ear(KEYS.health("leeloo_sim"), m.Nothing),
)
FREE = m.PlanRequest(
    goal=m.JointGoal(kind="joints", position=tuple(moved(0.3).tolist())), start=tuple(HOME), timeout=0.1
)
PLANNER = (
    Ear(KEYS.plan, m.PlanRequest, more=(FREE,)),
    Ear(KEYS.plan_cancel, m.CancelPlan),
    Ear(KEYS.ik, m.IkRequest),
    Ear(KEYS.fk, m.FkRequest, more=(m.FkRequest(joints=rows(np.zeros((2, 6)))),)),
    Ear(KEYS.check, m.CheckRequest, more=(m.CheckRequest(joints=rows(np.zeros((2, 6)))),)),
    Ear(KEYS.settings, m.SettingsChange),
    Ear(KEYS.scene_edit, m.SceneEdit),
    Ear(KEYS.health("planner"), m.Nothing),
    *(
        Ear(key, m.Nothing, "latched")
        for key in (KEYS.scene, KEYS.scene_revision, KEYS.scene_object("table"), KEYS.plans)
    ),
    Ear(
        KEYS.joint_states,
        m.JointState,
        "publication",
        (m.JointState(stamp=1.75e9, joint_names=JOINTS, position=tuple(HOME), velocity=(0.0,) * 6),),
    ),
)

PERCEPTION = (
    Ear(KEYS.cameras, m.CameraChange),
    Ear(KEYS.perception_clear, m.Nothing),
    Ear(KEYS.health("perception"), m.Nothing),
    Ear(KEYS.perception_state, m.Nothing, "latched"),
    Ear(KEYS.depth("wrist"), m.ImageHeader, "publication"),
    Ear(KEYS.depth("nobody"), m.ImageHeader, "publication"),
    Ear(KEYS.cloud("wrist"), m.CloudHeader, "publication"),
    Ear(KEYS.perception_load, m.SavedMap),
    Ear(
        KEYS.joint_states,
        m.JointState,
        "publication",
        (m.JointState(stamp=1.75e9, joint_names=JOINTS, position=tuple(HOME), velocity=(0.0,) * 6),),
    ),
    Ear(KEYS.scene, m.Scene, "publication"),
)


def means_something(ear: Ear, message: Message) -> bool:
    """Whether a payload is, by chance, what these keys are for: it moves the arm, breaks it, or tells where it is."""
    match message:
        case m.DriverCommand(joint_names=names):
            return len(names) == len(JOINTS)
        case m.DriverFault(jump=jump):
            return message != m.DriverFault() and (jump is None or len(jump) == len(JOINTS) or message.die)
        case m.JointState(joint_names=names):
            return ear.key == KEYS.driver_joint_states and set(names) >= set(JOINTS)
    return False


class Noise:
    """Sends payloads to ears and holds that each query is answered as it must be."""

    def __init__(self, ears: Sequence[Ear], session: zenoh.Session) -> None:
        self._ears = {ear.key: ear for ear in ears}
        self._session = session
        self.sent = 0

    def payloads(self) -> Iterator[tuple[str, bytes]]:
        """A fifth near misses, which take 5 ms each to make, the rest mutated bytes."""
        examples = {key: ear.examples for key, ear in self._ears.items()}
        yield from payloads.structured(examples, COUNT // 5, SEED)
        yield from payloads.mutated(examples, COUNT - COUNT // 5, SEED)

    def send(self, key: str, payload: bytes) -> None:
        """One payload to one key, unless it means something there."""
        ear = self._ears[key]
        try:
            message: Message | None = decode(ear.model, payload)
        except InvalidRequest:
            message = None
        if message is not None and means_something(ear, message):
            return
        self.sent += 1
        if ear.kind == "publication":
            self._session.put(key, payload, congestion_control=zenoh.CongestionControl.BLOCK)
            return
        replies = list(
            self._session.get(key, payload=payload, timeout=PATIENCE, congestion_control=zenoh.CongestionControl.BLOCK)
        )
        if ear.kind == "latched":
            assert all(reply.ok is not None for reply in replies)
            return
        (reply,) = replies
        assert reply.ok is not None or reply.err is not None
        if reply.err is not None:
            problem = decode(Problem, reply.err.payload.to_bytes())
            assert problem.code != "internal", (key, payload[:500], problem)
            assert message is not None or problem.code == "invalid_request", (key, payload[:500], problem)
        else:
            assert message is not None, (key, payload[:500])


class Sizes:
    """What the processes take: threads, descriptors, memory, lines of their logs."""

    def __init__(self, *services: ServiceProcess) -> None:
        self._services = services
        self.processes = [psutil.Process(service.process.pid) for service in services]

    def now(self) -> list[tuple[int, int, int]]:
        return [(p.num_threads(), p.num_fds(), p.memory_info().rss) for p in self.processes]

    def hold(self, before: list[tuple[int, int, int]]) -> None:
        """Fails where one of them has grown since, and stays so when all that was asked of it has ended."""
        try:
            eventually(lambda: not self._grown(before), "the services are no larger than before")
        finally:
            for service, then, now in zip(self._services, before, self.now(), strict=True):
                print(f"{service.service}: threads, descriptors, bytes {then} {now}, log {len(service.output())} bytes")  # noqa: T201

    def _grown(self, before: list[tuple[int, int, int]]) -> bool:
        return any(
            threads_now > threads + POOLS or fds_now > fds + 4 or rss_now > rss + GROWTH
            for (threads, fds, rss), (threads_now, fds_now, rss_now) in zip(before, self.now(), strict=True)
        )

    def hold_logs(self, sent: int) -> None:
        """Fails where noise fills a log, or where one has the trace of an exception."""
        for service in self._services:
            log = service.output()
            assert "Traceback" not in log, log[log.index("Traceback") - 500 :][:3000]
            warnings = [line for line in log.splitlines() if "level=WARNING" in line]
            assert len(warnings) <= 100 + sent / 20, f"{len(warnings)} warnings of {sent} payloads"
            assert max(map(len, log.splitlines())) < 3000


def shout(ears: Sequence[Ear], endpoint: str, sizes: Sizes) -> int:
    """Everything, to all; how many payloads were sent."""
    with open_client(endpoint) as session, ThreadPoolExecutor(CLIENTS) as pool:
        noise = Noise(ears, session)
        for enormous in payloads.ENORMOUS:
            for ear in ears:
                noise.send(ear.key, enormous)
        before = None
        made = noise.payloads()
        while batch := list(islice(made, max(COUNT // 10, 1))):
            list(pool.map(lambda one: noise.send(*one), batch))
            before = before or sizes.now()
        assert before is not None
        sizes.hold(before)
        sizes.hold_logs(noise.sent)
        return noise.sent


@pytest.mark.timeout(100 + COUNT / 20)
def test_executor_and_driver_survive_any_payload_at_rest(bus: Bus, endpoint: str, tmp_path: Path) -> None:
    with driven(bus, endpoint, tmp_path, "joint_speed") as robot:
        first = robot.at_rest()
        sizes = Sizes(robot.executor, robot.driver)
        reported, measured = robot.reported[-1], len(robot.client.measured)
        sent = shout((*EXECUTOR, *DRIVER), endpoint, sizes)
        assert sent > 0.8 * COUNT
        for service, process in (("executor", robot.executor), ("leeloo_sim", robot.driver)):
            assert process.process.poll() is None
            health = bus.call(KEYS.health(service), m.Nothing(), timeout=PATIENCE)
            assert health.pid == process.process.pid
        np.testing.assert_array_equal(robot.at_rest(), first)
        mine = [
            state for state in robot.reported if state.joint_names == reported.joint_names and not any(state.velocity)
        ]
        assert {state.position for state in mine} == {reported.position}
        assert {state.position for state in robot.client.measured[measured:]} == {tuple(first.tolist())}
        assert not any(any(state.velocity) for state in robot.client.measured[measured:])
        assert {goal.goal_id for goal in robot.client.goals} == set()
        favour(robot.driver, robot.executor)
        assert robot.client.strategy("joint_speed").active == "joint_speed"
        goal_id = robot.client.execute(rest_to_rest(moved(0.2)))
        assert robot.client.ended(goal_id).status == "succeeded"
        robot.works_again()


@pytest.mark.timeout(120 + COUNT / 20)
def test_the_planner_takes_any_payload_and_plans_afterwards(bus: Bus, endpoint: str, tmp_path: Path) -> None:
    with ServiceProcess("planner", endpoint, tmp_path) as planner:
        planner.wait_ready(bus, KEYS)
        settings = bus.call(KEYS.settings, m.SettingsChange(), timeout=PATIENCE)
        on_torch = m.FkRequest(joints=rows(np.zeros((1, 6))), device="cpu")
        bus.call(KEYS.fk, on_torch, timeout=PATIENCE)  # a payload may, by chance, be the first to load torch: 200 MB
        assert shout(PLANNER, endpoint, Sizes(planner)) > 0.8 * COUNT
        health = bus.call(KEYS.health("planner"), m.Nothing(), timeout=PATIENCE)
        assert health.ready
        assert health.pid == planner.process.pid
        back = m.SettingsChange(**settings.model_dump())
        assert bus.call(KEYS.settings, back, timeout=PATIENCE) == settings
        empty = m.SceneEdit(edit=m.LoadScene(op="load", objects=()))
        assert bus.call(KEYS.scene_edit, empty, timeout=PATIENCE).count == 0
        made = bus.call(KEYS.plan, FREE.model_copy(update={"timeout": 10.0}), timeout=PATIENCE)
        np.testing.assert_allclose(made.trajectory.position[-1], moved(0.3), atol=1e-6)


@pytest.mark.timeout(120 + COUNT / 20)
def test_the_perception_takes_any_payload_and_sees_afterwards(bus: Bus, endpoint: str, tmp_path: Path) -> None:
    with ServiceProcess("perception", endpoint, tmp_path) as perception:
        perception.wait_ready(bus, KEYS)
        assert shout(PERCEPTION, endpoint, Sizes(perception)) > 0.8 * COUNT
        health = bus.call(KEYS.health("perception"), m.Nothing(), timeout=PATIENCE)
        assert health.pid == perception.process.pid
        front = m.Camera(name="front", position=(0.7, 0.7, 1.0), orientation=(1.0, 0.0, 0.0, 0.0), **SMALL)
        cameras = bus.call(KEYS.cameras, m.CameraChange(), timeout=PATIENCE).cameras
        for camera in cameras:
            bus.call(KEYS.cameras, m.CameraChange(remove=camera.name), timeout=PATIENCE)
        assert bus.call(KEYS.cameras, m.CameraChange(add=front), timeout=PATIENCE).cameras == (front,)
        joints, images = bus.publisher(KEYS.joint_states), bus.publisher(KEYS.depth("front"))

        def sees() -> bool:
            now = time.time()
            joints.put(m.JointState(stamp=now, joint_names=JOINTS, position=tuple(HOME), velocity=(0.0,) * 6))
            header = m.ImageHeader(stamp=now, width=64, height=48, encoding="16UC1")
            images.put_encoded(encode_image(header, np.full((48, 64), 800, "<u2").tobytes()))
            return bus.read(KEYS.perception_state, timeout=PATIENCE).occupied > 0

        eventually(sees, "it sees")
