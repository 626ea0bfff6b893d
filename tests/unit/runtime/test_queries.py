"""Requests over a real router: an answer, a typed problem, or `unavailable`; never silence, never a false success."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import get_args

import pytest
import zenoh

from support.declared import declared
from support.harness import PATIENCE, eventually
from support.message_examples import by_class
from zarm_contract import messages as m
from zarm_contract.codec import MAX_BYTES, encode
from zarm_contract.errors import (
    Busy,
    Code,
    InternalError,
    InvalidRequest,
    Problem,
    Unavailable,
    from_problem,
)
from zarm_contract.key import Query
from zarm_contract.keys import Keys
from zarm_contract.messages import Message
from zarm_runtime.bus import Bus
from zarm_runtime.publications import Encoded
from zarm_runtime.queries import after_answer
from zarm_runtime.requester import ANYONE, requester

KEYS = Keys("arm")
REQUEST = m.FkRequest(joints=((0.1, 0.2),))
(ANSWER,) = by_class()[m.FkPoses]


def serve(bus: Bus, handler: Callable[[m.FkRequest], Message], *, workers: int = 2, backlog: int = 16) -> None:
    bus.serve(KEYS.fk, handler, workers=workers, backlog=backlog)
    declared(bus)


def call(bus: Bus, timeout: float = PATIENCE) -> m.FkPoses:
    return bus.call(KEYS.fk, REQUEST, timeout=timeout)


# -- answers --


def test_a_request_reaches_its_handler_and_the_answer_comes_back(bus: Bus, other: Bus) -> None:
    seen: list[m.FkRequest] = []

    def handler(request: m.FkRequest) -> m.FkPoses:
        seen.append(request)
        return ANSWER

    serve(bus, handler)
    assert call(other) == ANSWER
    assert seen == [REQUEST]


@pytest.mark.parametrize("code", get_args(Code))
def test_a_problem_crosses_the_bus_as_its_exception(bus: Bus, other: Bus, code: Code) -> None:
    problem = Problem(code=code, message="Something is wrong; do this.", field="joints.0", joint="elbow")

    def handler(_: m.FkRequest) -> m.FkPoses:
        raise from_problem(problem)

    serve(bus, handler)
    with pytest.raises(type(from_problem(problem))) as refusal:
        call(other)
    assert refusal.value.problem == problem


def test_a_handler_s_exception_is_internal_and_logged(bus: Bus, other: Bus, caplog: pytest.LogCaptureFixture) -> None:
    def handler(_: m.FkRequest) -> m.FkPoses:
        raise ZeroDivisionError("a fault of the handler")

    serve(bus, handler)
    with pytest.raises(InternalError, match="its log has the trace"):
        call(other)
    (record,) = caplog.records
    assert KEYS.fk in record.getMessage()
    assert record.exc_info is not None
    assert isinstance(record.exc_info[1], ZeroDivisionError)


def test_a_handler_that_failed_serves_the_next_request(bus: Bus, other: Bus) -> None:
    answers = iter([None, ANSWER])  # None is no message: a fault of the handler that shows as it is sent
    serve(bus, lambda _: next(answers))
    with pytest.raises(InternalError):
        call(other)
    assert call(other) == ANSWER


def test_work_after_the_answer_delays_no_client(bus: Bus, other: Bus, caplog: pytest.LogCaptureFixture) -> None:
    answered, done = threading.Event(), threading.Event()

    def finish() -> None:
        answered.wait(PATIENCE)
        done.set()
        raise ArithmeticError("nobody hears this but the log")

    def handler(_: m.FkRequest) -> m.FkPoses:
        after_answer(finish)
        return ANSWER

    serve(bus, handler, workers=1)
    assert call(other) == ANSWER
    assert not done.is_set()
    answered.set()
    assert call(other) == ANSWER  # the one worker goes on
    assert done.is_set()
    assert "nobody hears this but the log" in caplog.text


def test_an_answer_that_cannot_be_read_is_a_fault_of_zarm(bus: Bus, other: Bus) -> None:
    serve(bus, lambda _: m.Accepted(goal_id="goal-1"))
    with pytest.raises(InternalError, match="same version"):
        call(other)


# -- refusals --


def test_a_request_that_cannot_be_read_is_refused_with_its_field(bus: Bus, other: Bus) -> None:
    serve(bus, lambda _: ANSWER)
    with pytest.raises(InvalidRequest) as refusal:
        other.call(
            Query("planner/fk", m.CancelPlan, m.FkPoses, "Another request.", by=()).of_robot(KEYS.robot),
            m.CancelPlan(request_id="1"),
            timeout=PATIENCE,
        )
    assert refusal.value.problem.field == "joints"


def test_a_request_over_the_limit_is_refused(bus: Bus, other: Bus) -> None:
    bus.serve(KEYS.scene_edit, lambda _: m.SceneEdited(revision="1-5be0c1d2f3a4", count=0))
    declared(bus)
    names = ("n" * 64,) * (MAX_BYTES // 64)
    with pytest.raises(InvalidRequest) as refusal:
        other.call(KEYS.scene_edit, m.SceneEdit(edit=m.RemoveObjects(op="remove", names=names)), timeout=PATIENCE)
    assert refusal.value.problem.field == "payload"


def test_a_full_backlog_refuses_as_busy(bus: Bus, other: Bus) -> None:
    entered, release = threading.Semaphore(0), threading.Event()

    def handler(_: m.FkRequest) -> m.FkPoses:
        entered.release()
        release.wait(PATIENCE)
        return ANSWER

    serve(bus, handler, workers=2, backlog=0)
    with ThreadPoolExecutor(2) as callers:
        taken: list[Future[m.FkPoses]] = [callers.submit(call, other) for _ in range(2)]
        assert entered.acquire(timeout=PATIENCE)
        assert entered.acquire(timeout=PATIENCE)
        with pytest.raises(Busy, match="try again"):
            call(other)
        release.set()
        assert [future.result(PATIENCE) for future in taken] == [ANSWER, ANSWER]
    assert eventually(lambda: _answered(other), "there is room again") == ANSWER


def _answered(bus: Bus) -> m.FkPoses | None:
    try:
        return call(bus)
    except (Busy, Unavailable):
        return None


def test_where_nobody_serves_the_answer_is_unavailable_at_once(other: Bus) -> None:
    with pytest.raises(Unavailable, match=r"nobody answered on \S+; "):
        call(other)


def test_a_service_that_takes_too_long_is_unavailable(bus: Bus, other: Bus) -> None:
    release = threading.Event()

    def handler(_: m.FkRequest) -> m.FkPoses:
        release.wait(PATIENCE)
        return ANSWER

    serve(bus, handler)
    with pytest.raises(Unavailable, match=r"nobody answered on \S+ within 0.05 s; "):
        call(other, timeout=0.05)
    release.set()


# -- any Zenoh client --


def reply_to(session: zenoh.Session, selector: str, payload: bytes | None = None) -> list[bytes]:
    """The payloads of all replies, errors as well, to a plain Zenoh query."""
    return [
        (reply.ok or reply.err).payload.to_bytes() for reply in session.get(selector, payload=payload, timeout=PATIENCE)
    ]


def test_a_request_without_an_encoding_is_served(bus: Bus, plain: zenoh.Session) -> None:
    serve(bus, lambda _: ANSWER)
    assert reply_to(plain, KEYS.fk, b'{"joints": [[0.1, 0.2]]}') == [encode(ANSWER)]


def test_a_query_without_a_payload_is_an_empty_request(bus: Bus, plain: zenoh.Session) -> None:
    state, other = (
        m.ExecutorState(mode=mode, strategy="emulator", speed_scale=1.0, missed_ticks=0) for mode in ("idle", "fault")
    )
    bus.serve(KEYS.cancel, lambda request: state if request == m.CancelRequest() else other)
    declared(bus)
    assert reply_to(plain, KEYS.cancel) == [encode(state)]


def test_a_refusal_is_a_problem_for_any_client(bus: Bus, plain: zenoh.Session) -> None:
    serve(bus, lambda _: ANSWER)
    (payload,) = reply_to(plain, KEYS.fk, b'{"joints": [[0.1, NaN]]}')
    problem = Problem.model_validate_json(payload)
    assert (problem.code, problem.field) == ("invalid_request", "joints.0.1")


def test_an_answer_says_what_it_is(bus: Bus, plain: zenoh.Session) -> None:
    serve(bus, lambda _: ANSWER)
    (reply,) = plain.get(KEYS.fk, payload=encode(REQUEST), timeout=PATIENCE)
    assert reply.ok is not None
    assert str(reply.ok.encoding) == "application/json;zarm.FkPoses.v4"


def test_looking_around_sets_off_no_command(bus: Bus, plain: zenoh.Session) -> None:
    """`zarm/**` matches `executor/execute`, whose empty request moves the robot along the last plan."""
    moved: list[m.ExecuteRequest] = []

    def execute(request: m.ExecuteRequest) -> m.Accepted:
        moved.append(request)
        return m.Accepted(goal_id="goal-1")

    bus.serve(KEYS.execute, execute)
    declared(bus)
    for selector in ("zarm/**", "zarm/*/executor/*", "**"):
        assert reply_to(plain, selector) == []
        assert reply_to(plain, selector, b"{}") == []
    assert moved == []


def test_reading_everything_readable_changes_nothing(bus: Bus, plain: zenoh.Session) -> None:
    settings = m.PlannerSettings()
    changes: list[m.SettingsChange] = []

    def handler(change: m.SettingsChange) -> m.PlannerSettings:
        changes.append(change)
        return settings

    bus.serve(KEYS.settings, handler)
    declared(bus)
    assert reply_to(plain, "zarm/**") == [encode(settings)]
    assert reply_to(plain, "zarm/**", b'{"margin": 0.1}') == []
    assert changes == [m.SettingsChange()]


@pytest.mark.lengthy
def test_the_zenoh_command_line_client_can_call_a_service(bus: Bus, endpoint: str) -> None:
    serve(bus, lambda _: ANSWER)
    zenoh_cli = Path(sys.executable).with_name("zenoh")
    command = [zenoh_cli, "--mode", "client", "--connect", endpoint, "get", "--decoder", "text"]
    done = subprocess.run(
        [*command, "-s", KEYS.fk, "-v", '{"joints": [[0.1, 0.2]]}'],
        capture_output=True,
        text=True,
        check=True,
        timeout=PATIENCE,
    )
    assert done.stdout.strip().encode() == encode(ANSWER)


# -- who asks --


def test_a_handler_is_told_who_asks_and_how_long_that_waits(bus: Bus, other: Bus, plain: zenoh.Session) -> None:
    askers: list[m.Requester] = []

    def handler(_: m.FkRequest) -> m.FkPoses:
        askers.append(requester())
        return ANSWER

    serve(bus, handler)
    call(other, timeout=PATIENCE)
    call(bus, timeout=PATIENCE / 2)
    reply_to(plain, KEYS.fk, encode(REQUEST))
    list(plain.get(KEYS.fk, payload=encode(REQUEST), attachment=b"another tool's", timeout=PATIENCE))
    first, second, *others = askers
    assert (first.timeout, second.timeout) == (PATIENCE, PATIENCE / 2)
    assert len({first.client, second.client, ANYONE.client}) == 3
    assert others == [ANYONE, ANYONE]
    assert requester() == ANYONE


def test_a_client_has_its_share_of_requests(bus: Bus, other: Bus) -> None:
    entered, release = threading.Semaphore(0), threading.Event()

    def handler(_: m.FkRequest) -> m.FkPoses:
        entered.release()
        if requester().timeout == PATIENCE:
            release.wait(PATIENCE)
        return ANSWER

    bus.serve(KEYS.fk, handler, workers=4, backlog=0, shared=True)
    declared(bus)
    with ThreadPoolExecutor(2) as callers:
        taken = [callers.submit(call, other) for _ in range(2)]
        assert entered.acquire(timeout=PATIENCE)
        assert entered.acquire(timeout=PATIENCE)
        with pytest.raises(Busy, match=r"2 pending requests of this client.*2 free places.*wait for an answer"):
            call(other)
        assert call(bus, timeout=PATIENCE / 2) == ANSWER
        release.set()
        assert [future.result(PATIENCE) for future in taken] == [ANSWER, ANSWER]
    assert eventually(lambda: _answered(other), "there is room again") == ANSWER


@pytest.mark.lengthy
@pytest.mark.parametrize("signum", [signal.SIGTERM, signal.SIGKILL])
def test_a_client_that_leaves_or_dies_is_told_of(bus: Bus, endpoint: str, signum: signal.Signals) -> None:
    asked: list[str] = []
    gone: list[str] = []
    release = threading.Event()

    def handler(_: m.FkRequest) -> m.FkPoses:
        asked.append(requester().client)
        release.wait(PATIENCE)
        return ANSWER

    serve(bus, handler)
    bus.watch_clients(gone.append)
    script = f"""
from zarm_runtime.bus import Bus
from zarm_contract.keys import Keys
from zarm_contract.messages import FkRequest
with Bus({endpoint!r}) as bus:
    bus.call(Keys({KEYS.robot!r}).fk, FkRequest(joints=((0.1, 0.2),)), timeout={PATIENCE})
"""
    client = subprocess.Popen([sys.executable, "-c", script])
    try:
        eventually(lambda: asked, "it asks")
        assert gone == []
        client.send_signal(signum)
        eventually(lambda: gone, "it has left")
        assert gone == asked
    finally:
        client.kill()
        client.wait()
        release.set()


# -- answers that cannot be sent --


def test_an_answer_that_cannot_be_sent_is_logged_and_counted(
    bus: Bus, other: Bus, plain: zenoh.Session, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    outcomes: list[str] = []

    def unsendable(_: m.Message) -> Encoded:
        return Encoded(b"", object())  # type: ignore[arg-type]

    bus.watch_answers(lambda _, outcome: outcomes.append(outcome))
    serve(bus, lambda _: ANSWER)
    with monkeypatch.context() as patch:
        patch.setattr(Encoded, "of", unsendable)
        assert reply_to(plain, KEYS.fk, encode(REQUEST)) == []
        (record,) = eventually(lambda: [one for one in caplog.records if KEYS.fk in one.getMessage()], "it is logged")
    assert record.exc_info is not None
    assert isinstance(record.exc_info[1], TypeError)
    assert eventually(lambda: outcomes, "it is counted") == ["unsent"]
    assert call(other) == ANSWER
