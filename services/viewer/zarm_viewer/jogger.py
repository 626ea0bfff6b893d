"""Jogging with a dead man's switch: the robot moves only while the page keeps sending requests.

A page repeats its request while a button is held. If the requests end, as when the page is closed or frozen, nothing is
sent to the servo, whose target becomes stale, and the robot brakes. Requests that were held up, as when the network or
this process stood still, arrive all at once and move nothing. The page that jogs keeps the robot until a second after
its last request.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import Literal

from viser import ClientHandle

from zarm.servoing import PERIOD, Jogging, Tracking
from zarm_contract.errors import ZarmError
from zarm_viewer.panel_context import PanelContext

log = logging.getLogger(__name__)

HOLD = 0.15
"""How long (s) a request counts; a page sends one every 0.05 s while a button is held."""
LINGER = 1.0
"""How long (s) the session stays open after the last request."""
SOONEST, LATEST = 0.01, 0.5
"""Interval (s) after the previous request in which a request counts: one that comes sooner was held up, one that comes
later is the first.
"""
_REPORT_PERIOD = 3.0  # least time (s) between two notices that the robot is taken

Kind = Literal["jog", "track"]
Send = Callable[[Jogging | Tracking], None]


class Held:
    """Whether a button is held now, judged by the timing of requests."""

    def __init__(self) -> None:
        self._before: dict[int, float] = {}

    def asked(self, client_id: int, now: float) -> bool:
        """Whether a request of a page at `now` (s, monotonic) counts."""
        since, self._before[client_id] = now - self._before.get(client_id, -LATEST), now
        return SOONEST <= since <= LATEST

    def forget(self, client_id: int) -> None:
        """This page is gone."""
        self._before.pop(client_id, None)


class Jogger:
    """The current jog of a robot. Thread-safe."""

    def __init__(self, panels: PanelContext) -> None:
        self._panels = panels
        self._changed = threading.Condition()
        self._owner: int | None = None
        self._held = Held()
        self._kind: Kind = "jog"
        self._send: Send | None = None
        self._until = 0.0
        self._reported = 0.0
        panels.server.on_client_disconnect(lambda client: self.release(client.client_id))
        threading.Thread(target=self._run, name="jog", daemon=True).start()

    def ask(self, client: ClientHandle | None, kind: Kind, send: Send, hold: float = HOLD) -> None:
        """Send this to a session of `kind` for the next `hold` s. If another page is jogging, it keeps the robot, and
        this one is told so.
        """
        if client is None:
            return
        now = time.monotonic()
        with self._changed:
            if self._owner not in (None, client.client_id):
                if now - self._reported > _REPORT_PERIOD:
                    self._reported = now
                    client.add_notification("Somebody else jogs", "Try again when they have let go.", color="orange")
                return
            if self._held.asked(client.client_id, now):
                self._owner, self._kind, self._send, self._until = client.client_id, kind, send, now + hold
                self._changed.notify()

    def release(self, client_id: int) -> None:
        """This page has stopped jogging."""
        with self._changed:
            self._held.forget(client_id)
            if self._owner == client_id:
                self._until = 0.0
                self._changed.notify()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: time.monotonic() < self._until)
                kind = self._kind
            try:
                robot = self._panels.robot
                with robot.jog() if kind == "jog" else robot.track() as session:
                    self._lead(session, kind)
            except ZarmError as error:
                self._panels.notify(f"jog: {error.problem.code}", str(error), colour="red")
                with self._changed:
                    self._until = 0.0
            except Exception:
                log.exception("jogging failed")
            finally:
                with self._changed:
                    self._owner = None

    def _lead(self, session: Jogging | Tracking, kind: Kind) -> None:
        while session.running:
            with self._changed:
                now = time.monotonic()
                send = self._send if now < self._until else None
                if self._kind != kind or now > self._until + LINGER:
                    return
            if send is not None:
                send(session)
            with self._changed:
                self._changed.wait(PERIOD)
