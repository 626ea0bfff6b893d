"""Publications over a real router: who comes late sees the present state, who reads garbage goes on."""

from __future__ import annotations

import queue
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing

import pytest
import zenoh

from support.declared import declared
from support.harness import PATIENCE, eventually, free_endpoint
from support.message_examples import by_class
from support.network.link import link
from zarm_contract import messages as m
from zarm_contract.codec import decode, encode
from zarm_contract.errors import InternalError, Problem
from zarm_contract.key import Topic
from zarm_contract.keys import Keys
from zarm_runtime.bus import Bus
from zarm_runtime.session import listens_at, router_config, run_router

KEYS = Keys("arm")
(JOINTS,) = by_class()[m.JointState]
IDLE = m.ExecutorState(mode="idle", strategy="emulator", speed_scale=1.0, missed_ticks=0)
RUNNING = m.ExecutorState(mode="running", strategy="emulator", goal_id="goal-1", speed_scale=1.0, missed_ticks=0)
(GOAL,) = by_class()[m.GoalState]

Inbox = queue.SimpleQueue[tuple[str, m.ExecutorState]]


def stamped(stamp: float) -> m.JointState:
    return JOINTS.model_copy(update={"stamp": stamp})


# -- latched values --


@pytest.mark.lengthy
def test_every_value_of_a_burst_reaches_a_slow_reader() -> None:
    """As many as no buffer between the two holds."""
    config = router_config(free_endpoint())
    config.insert_json5("transport/link/tx/queue/congestion_control/block/wait_before_close", str(int(PATIENCE * 1e6)))
    endpoint, *_ = listens_at(config)
    long = Problem(code="internal", message="x" * 10_000)
    values = [GOAL.model_copy(update={"elapsed": float(number), "problem": long}) for number in range(3000)]
    seen: list[float] = []
    goes_on = threading.Event()

    def read(_: str, goal: m.GoalState) -> None:
        goes_on.wait()
        seen.append(goal.elapsed)

    with closing(run_router(config)), Bus(endpoint) as publishing, Bus(endpoint) as reading:
        goals = publishing.latched(KEYS.goal("*"))
        reading.subscribe(KEYS.goal("*"), read)
        declared(reading)
        published = 0

        def publish() -> None:
            nonlocal published
            for value in values:
                goals.set(value, key=KEYS.goal("goal-1"))
                published += 1

        thread = threading.Thread(target=publish)
        thread.start()
        before = -1
        while thread.is_alive() and published > before:  # until it waits for room, or has no need to
            before = published
            thread.join(0.1)
        goes_on.set()
        thread.join()
        eventually(lambda: seen[-1:] == [values[-1].elapsed], "the last one is read", 10)
    assert seen == [value.elapsed for value in values]


def test_a_late_joiner_gets_the_present_state_and_changes(bus: Bus, other: Bus) -> None:
    state = bus.latched(KEYS.executor_state)
    state.set(RUNNING)
    state.set(IDLE)
    declared(bus)
    inbox: Inbox = queue.SimpleQueue()
    other.watch(KEYS.executor_state, lambda key, message: inbox.put((key, message)))
    assert inbox.get_nowait() == (KEYS.executor_state, IDLE)
    declared(other)
    state.set(RUNNING)
    assert inbox.get(timeout=PATIENCE) == (KEYS.executor_state, RUNNING)
    assert inbox.empty()


def test_a_plain_query_reads_a_latched_value_and_what_it_is(bus: Bus, plain: zenoh.Session) -> None:
    bus.latched(KEYS.executor_state).set(IDLE)
    declared(bus)
    (reply,) = plain.get("zarm/*/executor/state", timeout=PATIENCE)
    assert reply.ok is not None
    assert str(reply.ok.key_expr) == KEYS.executor_state
    assert reply.ok.payload.to_bytes() == encode(IDLE)
    assert str(reply.ok.encoding) == "application/json;zarm.ExecutorState.v4"


def test_a_latched_value_that_is_not_set_yet_answers_nothing(bus: Bus, other: Bus) -> None:
    bus.latched(KEYS.executor_state)
    declared(bus)
    inbox: Inbox = queue.SimpleQueue()
    other.watch(KEYS.executor_state, lambda key, message: inbox.put((key, message)))
    assert inbox.empty()


def test_a_change_can_be_read_at_once_and_is_published_in_order(bus: Bus, other: Bus) -> None:
    states, seen = bus.latched(KEYS.executor_state), queue.SimpleQueue[m.ExecutorState]()
    other.subscribe(KEYS.executor_state, lambda _, state: seen.put(state))
    declared(other)
    states.change(RUNNING)
    states.change(IDLE)
    assert other.read(KEYS.executor_state, timeout=PATIENCE) == IDLE
    assert seen.empty()
    states.set(RUNNING)
    assert [seen.get(timeout=PATIENCE) for _ in range(3)] == [RUNNING, IDLE, RUNNING]


def test_a_family_answers_for_one_member_or_for_all(bus: Bus, plain: zenoh.Session) -> None:
    goals = bus.latched(KEYS.goal("*"))
    expected = {}
    for name in ("goal-1", "goal-2", "goal-3"):
        expected[KEYS.goal(name)] = GOAL.model_copy(update={"goal_id": name})
        goals.set(expected[KEYS.goal(name)], key=KEYS.goal(name))
    declared(bus)

    def read(selector: str) -> dict[str, m.GoalState]:
        replies = [reply.ok for reply in plain.get(selector, timeout=PATIENCE)]
        return {str(ok.key_expr): decode(m.GoalState, ok.payload.to_bytes()) for ok in replies if ok is not None}

    assert read(KEYS.goal("goal-2")) == {KEYS.goal("goal-2"): expected[KEYS.goal("goal-2")]}
    assert read(KEYS.goal("*")) == expected
    assert read("zarm/**") == expected
    assert read(KEYS.goal("goal-4")) == {}
    goals.forget(KEYS.goal("goal-2"))
    assert set(read(KEYS.goal("*"))) == {KEYS.goal("goal-1"), KEYS.goal("goal-3")}


def test_each_member_of_a_family_says_what_it_is(bus: Bus, plain: zenoh.Session) -> None:
    objects = bus.latched(KEYS.scene_object("*"))
    for (example,) in (by_class()[m.Sphere], by_class()[m.Cuboid]):
        objects.set(example, key=KEYS.scene_object(example.name))
    declared(bus)
    replies = [reply.ok for reply in plain.get(KEYS.scene_object("*"), timeout=PATIENCE)]
    encodings = {str(ok.key_expr): str(ok.encoding) for ok in replies if ok is not None}
    assert encodings == {
        KEYS.scene_object("ball.1"): "application/json;zarm.Sphere.v4",
        KEYS.scene_object("table"): "application/json;zarm.Cuboid.v4",
    }


def test_a_watcher_of_a_family_sees_every_member_and_new_ones(bus: Bus, other: Bus) -> None:
    goals = bus.latched(KEYS.goal("*"))
    goals.set(GOAL, key=KEYS.goal("goal-1"))
    declared(bus)
    inbox: queue.SimpleQueue[tuple[str, m.GoalState]] = queue.SimpleQueue()
    other.watch(KEYS.goal("*"), lambda key, message: inbox.put((key, message)))
    assert inbox.get_nowait()[0] == KEYS.goal("goal-1")
    declared(other)
    goals.set(GOAL, key=KEYS.goal("goal-2"))
    assert inbox.get(timeout=PATIENCE)[0] == KEYS.goal("goal-2")


@pytest.mark.lengthy
def test_a_watcher_gets_what_it_missed_while_disconnected(bus: Bus, endpoint: str) -> None:
    state, goals = bus.latched(KEYS.executor_state), bus.latched(KEYS.goal("*"))
    state.set(IDLE)
    declared(bus)
    states: queue.SimpleQueue[m.ExecutorState] = queue.SimpleQueue()
    seen: queue.SimpleQueue[str] = queue.SimpleQueue()
    with link(endpoint) as wire, Bus(wire.endpoint) as far:
        far.watch(KEYS.executor_state, lambda _, message: states.put(message))
        far.watch(KEYS.goal("*"), lambda key, _: seen.put(key))
        assert states.get_nowait() == IDLE
        for value, name in ((RUNNING, "goal-1"), (IDLE, "goal-2")):
            wire.cut()
            state.set(value)
            goals.set(GOAL, key=KEYS.goal(name))
            assert states.empty()
            wire.restore()
            assert states.get(timeout=PATIENCE) == value
            assert KEYS.goal(name) in iter(lambda: seen.get(timeout=PATIENCE), None)


def test_a_key_that_takes_requests_can_be_watched_as_well(bus: Bus, other: Bus) -> None:
    """`planner/settings` is served and published: an empty request reads."""
    before, after = m.PlannerSettings(), m.PlannerSettings(margin=0.02)
    bus.serve(KEYS.settings, lambda _: before)
    publisher = bus.publisher(KEYS.settings)
    declared(bus)
    inbox: queue.SimpleQueue[m.PlannerSettings] = queue.SimpleQueue()
    other.watch(KEYS.settings, lambda _, message: inbox.put(message))
    assert inbox.get_nowait() == before

    def published() -> bool:
        publisher.put(after)
        return not inbox.empty()

    eventually(published, "the change arrives")
    assert inbox.get_nowait() == after


def test_the_last_call_of_a_watcher_is_with_the_newest_value(plain: zenoh.Session, other: Bus) -> None:
    """The answer to the query is on its way while the value changes: it is older and must not come last."""
    inbox: Inbox = queue.SimpleQueue()
    changed = threading.Event()

    def receive(key: str, message: m.ExecutorState) -> None:
        inbox.put((key, message))
        changed.set()

    def answer(query: zenoh.Query) -> None:
        with query:
            while not changed.is_set():
                plain.put(KEYS.executor_state, encode(RUNNING))
                changed.wait(0.01)
            query.reply(KEYS.executor_state, encode(IDLE))

    queryable = plain.declare_queryable(KEYS.executor_state, answer, complete=True)
    list(plain.liveliness().get("zarm/*/*/@alive/*", timeout=PATIENCE))
    other.watch(KEYS.executor_state, receive, timeout=PATIENCE)
    queryable.undeclare()
    assert changed.is_set()
    while not inbox.empty():
        assert inbox.get_nowait() == (KEYS.executor_state, RUNNING)


# -- subscribers --


def test_a_subscriber_drops_what_it_cannot_read_and_goes_on(
    plain: zenoh.Session, other: Bus, caplog: pytest.LogCaptureFixture
) -> None:
    inbox: Inbox = queue.SimpleQueue()
    other.subscribe(KEYS.executor_state, lambda key, message: inbox.put((key, message)))
    declared(other)
    for garbage in (b"", b"\xff\x00", b"[]", b'{"mode": "flying"}'):
        plain.put(KEYS.executor_state, garbage)
    plain.put(KEYS.executor_state, encode(IDLE))
    assert inbox.get(timeout=PATIENCE) == (KEYS.executor_state, IDLE)
    assert inbox.empty()
    assert [record.levelname for record in caplog.records] == ["WARNING"] * 4
    assert all(KEYS.executor_state in record.getMessage() for record in caplog.records)


def test_a_failing_subscriber_is_logged_and_goes_on(
    plain: zenoh.Session, other: Bus, caplog: pytest.LogCaptureFixture
) -> None:
    inbox: Inbox = queue.SimpleQueue()

    def receive(key: str, message: m.ExecutorState) -> None:
        if message == RUNNING:
            raise InternalError("a fault of the subscriber")
        inbox.put((key, message))

    other.subscribe(KEYS.executor_state, receive)
    declared(other)
    plain.put(KEYS.executor_state, encode(RUNNING))
    plain.put(KEYS.executor_state, encode(IDLE))
    assert inbox.get(timeout=PATIENCE) == (KEYS.executor_state, IDLE)
    (record,) = caplog.records
    assert record.exc_info is not None


def test_a_deletion_on_the_bus_is_no_message(plain: zenoh.Session, other: Bus) -> None:
    """Its payload is empty, which would read as an empty request."""
    inbox: queue.SimpleQueue[m.CancelRequest] = queue.SimpleQueue()
    news = Topic("news", m.CancelRequest, "News.", by=("operator",)).of_robot(KEYS.robot)
    other.subscribe(news, lambda _, message: inbox.put(message))
    latest = other.latest(news)
    declared(other)
    request = m.CancelRequest(goal_id="goal-1")
    with ThreadPoolExecutor(1) as pool:
        waiting = pool.submit(latest.wait, PATIENCE)
        for _ in range(100):
            plain.delete(news)
        plain.put(news, encode(request))
        assert inbox.get(timeout=PATIENCE) == request

        def over() -> bool:
            plain.put(news, encode(request))
            return waiting.done()

        eventually(over, "the wait is over")
    assert waiting.result() == request


# -- the newest message --


@pytest.mark.parametrize("realtime", [False, True], ids=["queued", "realtime"])
def test_the_newest_message_is_kept_and_knows_its_age(bus: Bus, other: Bus, realtime: bool) -> None:
    latest = other.latest(KEYS.joint_states)
    assert latest.get() is None
    assert latest.get(max_age=PATIENCE) is None
    publisher = bus.publisher(KEYS.joint_states)

    def arrived(stamp: float) -> bool:
        publisher.put(stamped(stamp))
        newest = latest.get(max_age=PATIENCE)
        return newest is not None and newest.stamp == stamp

    for stamp in (1.0, 2.0):
        eventually(lambda stamp=stamp: arrived(stamp), "the message arrives")
    assert latest.get() == stamped(2.0)
    message, at = latest.received()
    assert message == stamped(2.0)
    assert time.monotonic() - PATIENCE < at < time.monotonic()
    assert latest.get(max_age=0.0) is None


def test_waiting_returns_the_next_message(plain: zenoh.Session, other: Bus) -> None:
    latest = other.latest(KEYS.joint_states)
    declared(other)
    plain.put(KEYS.joint_states, encode(stamped(1.0)))
    eventually(latest.get, "the first message is there")
    with ThreadPoolExecutor(1) as pool:
        waiting = pool.submit(latest.wait, PATIENCE)

        def over() -> bool:
            plain.put(KEYS.joint_states, encode(stamped(2.0)))
            return waiting.done()

        eventually(over, "the wait is over")
    assert waiting.result() == stamped(2.0)


def test_waiting_in_vain_ends(other: Bus) -> None:
    assert other.latest(KEYS.joint_states).wait(0.01) is None


def test_the_newest_message_is_dropped_when_it_cannot_be_read(
    plain: zenoh.Session, other: Bus, caplog: pytest.LogCaptureFixture
) -> None:
    latest = other.latest(KEYS.joint_states)
    declared(other)
    plain.put(KEYS.joint_states, b'{"stamp": NaN}')
    eventually(lambda: latest.get() is None and caplog.records, "the garbage is noticed")
    assert latest.get() is None
    assert len(caplog.records) == 1
    plain.put(KEYS.joint_states, encode(JOINTS))
    assert eventually(latest.get, "the next message is there") == JOINTS


# -- liveliness --


def test_a_token_shows_a_process_until_it_ends(endpoint: str, other: Bus) -> None:
    everyone = KEYS.alive("*", "*")
    assert other.alive(everyone) == []
    with Bus(endpoint) as first, Bus(endpoint) as second:
        first.declare_alive(KEYS.alive("planner", "b"))
        first.declare_alive(KEYS.alive("planner", "a"))
        second.declare_alive(Keys("arm_2").alive("planner", "c"))
        declared(first)
        declared(second)
        assert other.alive(everyone) == [("arm", "planner", "a"), ("arm", "planner", "b")]
        assert other.alive("zarm/*/*/@alive/*") == [*other.alive(everyone), ("arm_2", "planner", "c")]
    eventually(lambda: other.alive("zarm/*/*/@alive/*") == [], "the tokens are gone")


# -- observation --


def test_an_observer_gets_all_raw_messages(bus: Bus, other: Bus) -> None:
    bus.latched(KEYS.executor_state).set(IDLE)
    declared(bus)
    sent: list[tuple[str, bytes]] = []
    received: list[tuple[str, bytes]] = []
    bus.observe(lambda key, payload: sent.append((key, payload)))
    other.observe(lambda key, payload: received.append((key, payload)))
    inbox: Inbox = queue.SimpleQueue()
    other.watch(KEYS.executor_state, lambda key, message: inbox.put((key, message)))
    other.subscribe(KEYS.goal("*"), lambda _, __: None)
    latest = other.latest(KEYS.joint_states)
    goals, joints = bus.latched(KEYS.goal("*")), bus.publisher(KEYS.joint_states)
    declared(other)
    goals.set(GOAL, key=KEYS.goal("goal-1"))
    joints.put(JOINTS)
    published = [(KEYS.goal("goal-1"), encode(GOAL)), (KEYS.joint_states, encode(JOINTS))]
    assert sent == published
    eventually(lambda: len(received) == 3, "all is received")
    assert sorted(received) == sorted([(KEYS.executor_state, encode(IDLE)), *published])
    assert latest.get() == JOINTS


def test_whoever_listens_is_given_what_cannot_be_read_too(bus: Bus, plain: zenoh.Session) -> None:
    has_subscribers: queue.SimpleQueue[tuple[str, bytes]] = queue.SimpleQueue()
    bus.listen(KEYS.driver_joint_states, lambda key, payload: has_subscribers.put((key, payload)))
    declared(bus)
    plain.put(KEYS.driver_joint_states, b"noise")
    assert has_subscribers.get(timeout=PATIENCE) == (KEYS.driver_joint_states, b"noise")
