"""Queries: a key served by its own threads, and a request that waits for its reply."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextvars import ContextVar
from functools import partial
from typing import Any, Generic, NoReturn, TypeVar

import zenoh

from zarm_contract.codec import CONTRACT, decode, encode, other_contract
from zarm_contract.errors import Busy, InternalError, InvalidRequest, Problem, Unavailable, ZarmError, from_problem
from zarm_contract.key import Query
from zarm_contract.messages import Message, Requester
from zarm_contract.roles import Role
from zarm_runtime.publications import Encoded, encoding_of
from zarm_runtime.quota import Quota
from zarm_runtime.requester import on_behalf_of, requester_of

log = logging.getLogger(__name__)

Request = TypeVar("Request", bound=Message)
Reply = TypeVar("Reply", bound=Message)

_after_answer: ContextVar[list[Callable[[], object]]] = ContextVar("after_answer")


def after_answer(work: Callable[[], object]) -> None:
    """For handlers: call `work` in this thread once the query at hand is answered, so that its client need not wait."""
    _after_answer.get().append(work)


class Served(Generic[Request, Reply]):
    """A key whose queries are answered by `handler(request, arrival)`, in up to `workers` threads; see `Bus.serve`.

    `answered` is called for each query with the key, and `ok`, `unsent` or the code of the problem.
    """

    def __init__(
        self,
        key: Query[Request, Reply],
        handler: Callable[[Request, int], Reply | Encoded],
        workers: int,
        room: Quota,
        answered: Callable[[str, str], object],
    ) -> None:
        self._key, self._handler = key, handler
        self._quota, self._answered = room, answered
        self._pool = ThreadPoolExecutor(workers, thread_name_prefix=key)
        self._refusing = ThreadPoolExecutor(1, thread_name_prefix=f"{key} refuses")
        self.pools = (self._pool, self._refusing)

    def admit(self, query: zenoh.Query, arrival: int = 0) -> None:
        """Hand a query to a worker, or refuse it; returns at once."""
        if str(query.key_expr) != self._key and not (self._key.readable and query.payload is None):
            with query:
                return
        who = requester_of(query)
        try:
            self._quota.enter(who.client)
        except Busy as busy:
            self._hand_over(self._refusing, self._answer, query, partial(_refuse, busy))
            return
        if not self._hand_over(self._pool, self._handle, query, who, arrival):
            self._quota.leave(who.client)

    def _hand_over(self, to: ThreadPoolExecutor, work: Callable[..., None], query: zenoh.Query, *rest: object) -> bool:
        try:
            to.submit(work, query, *rest)
        except RuntimeError:  # the pools are shut down: this service is closing
            self._answer(query, partial(_refuse, Unavailable(f"{self._key} is shutting down")))
            return False
        return True

    def _handle(self, query: zenoh.Query, who: Requester, arrival: int) -> None:
        rest: list[Callable[[], object]] = []
        _after_answer.set(rest)
        try:
            with on_behalf_of(who):
                self._answer(query, lambda: self._handler(_request(query, self._key), arrival))
        finally:
            self._quota.leave(who.client)
        try:
            for work in rest:
                work()
        except Exception:
            log.exception("work after an answer failed key=%s", self._key)

    def _answer(self, query: zenoh.Query, work: Callable[[], Message | Encoded]) -> None:
        try:
            with query:
                self._answered(self._key, _reply(query, self._key, work))
        except Exception:
            log.exception("answer not sent key=%s", self._key)
            self._answered(self._key, "unsent")


def ask(
    session: zenoh.Session, key: str, reply: type[Reply], timeout: float, role: Role | None, **request: Any
) -> Reply:
    """The answer to a query; `request` holds its payload, encoding and attachment. Raises what `Bus.call` raises for
    answers.
    """
    refused = "" if role is None else f", or the router there lets no {role} ask"
    began = time.monotonic()

    def unavailable() -> Unavailable:
        late = f" within {timeout:g} s" if time.monotonic() - began > 0.9 * timeout else ""  # else nobody serves it
        asked = key.removesuffix("$*")  # of a key that is only read
        return Unavailable(f"nobody answered on {asked}{late}{refused}; `zarm status` shows which services run")

    try:
        replies = session.get(
            key, timeout=timeout, congestion_control=zenoh.CongestionControl.BLOCK, express=True, **request
        )
        first = next(iter(replies), None)
    except zenoh.ZError as error:
        raise unavailable() from error
    if first is None:
        raise unavailable()
    if first.ok is not None:
        other = None if reply.any_contract else other_contract(str(first.ok.encoding))
        if other is not None:
            raise InternalError(
                f"the service on {key} speaks contract {other}, and this client {CONTRACT}; run the same version of "
                "zarm on both sides (`zarm status` shows who runs which)"
            )
        try:
            return decode(reply, first.ok.payload.to_bytes())
        except InvalidRequest as error:
            raise InternalError(
                f"the answer on {key} cannot be read: {error}; run the same version of zarm on both sides"
            ) from error
    if first.err is None:
        raise unavailable()
    try:
        problem = decode(Problem, first.err.payload.to_bytes())
    except InvalidRequest:  # Zenoh's own error reply, such as a timeout, is not a Problem
        raise unavailable() from None
    raise from_problem(problem)


def _request(query: zenoh.Query, key: Query[Request, Reply]) -> Request:
    other = None if key.request.any_contract or query.encoding is None else other_contract(str(query.encoding))
    if other is not None:
        raise InvalidRequest(
            f"this request is of contract {other}, and {key} speaks {CONTRACT}; run the same version of zarm on both sides "
            "(`zarm status` shows who runs which)"
        )
    return decode(key.request, query.payload.to_bytes() if query.payload is not None else b"")


def _refuse(error: ZarmError) -> NoReturn:
    raise error


def _reply(query: zenoh.Query, key: str, work: Callable[[], Message | Encoded]) -> str:
    """Answer with the result of `work`; returns `ok`, or the code of its problem."""
    try:
        answer = work()
        encoded = answer if isinstance(answer, Encoded) else Encoded.of(answer)
    except ZarmError as error:
        _reply_problem(query, error)
        return error.code
    except Exception:
        log.exception("handler failed key=%s", key)
        _reply_problem(query, InternalError(f"{key} failed on this request; its log has the trace"))
        return "internal"
    query.reply(key, encoded.payload, encoding=encoded.encoding, express=True)
    return "ok"


def _reply_problem(query: zenoh.Query, error: ZarmError) -> None:
    query.reply_err(encode(error.problem), encoding=encoding_of(Problem))
