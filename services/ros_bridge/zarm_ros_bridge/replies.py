"""Replies to clients that DDS has not fully discovered yet.

DDS discovers the two directions of a service one after the other, so a request may arrive before the way back to its
client is known. rmw_fastrtps waits a moment for it (`dds_network.xml`), during which rclpy blocks all other Python
threads; then it drops the reply, rclpy warns, and the client waits for ever. rclpy offers no other place to send the
reply again than where it is sent.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from typing import Any

from zarm_ros_bridge.rclpy_parts import SENDERS, UNSENT, RCLError

PATIENCE = 4.0
"""How long (s) a reply is retried: a heartbeat of Fast DDS, 3 s, recovers a lost description of a client. One that
requests durability, or another QoS that services lack, is never found.
"""
_SOON, _LATE = 0.01, 0.5  # seconds before retrying: as long again as it has waited so far


class Unanswered(RCLError):  # type: ignore[misc] # rclpy is not followed
    """A client has no reply. If that was the acceptance of its goal, rclpy does not execute the goal."""


def insist() -> None:
    """From now on every service and action of this process retries its replies for PATIENCE s, then raises Unanswered.
    Call once.
    """
    warnings.filterwarnings("error", UNSENT, RuntimeWarning)
    for kind, name in SENDERS:
        setattr(kind, name, insistent(getattr(kind, name)))


def insistent(send: Callable[..., None]) -> Callable[..., None]:
    """`send`, whose warning means that it has not sent, repeated until it has. Raises Unanswered."""

    def send_until_sent(handle: Any, *reply: Any) -> None:
        began = time.monotonic()
        while not _sent(send, handle, *reply):
            waited = time.monotonic() - began
            if waited > PATIENCE:
                raise Unanswered(
                    f"a client of {getattr(handle, 'name', 'an action')} has no reply: DDS has not matched it for {waited:.1f} s; "
                    "check that it uses the default QoS of services"
                )
            time.sleep(min(max(waited, _SOON), _LATE))

    return send_until_sent


def _sent(send: Callable[..., None], handle: Any, *reply: Any) -> bool:
    try:
        send(handle, *reply)
    except (RuntimeWarning, SystemError) as error:
        # rclpy continues after a warning raised as an error, and Python then raises SystemError.
        if not isinstance(error.__cause__ or error, RuntimeWarning):
            raise
        return False
    return True
