"""Replies to clients that DDS is still getting to know.

DDS finds the two directions of a service one after the other, so a request may come before the way back to its client is known.
rmw_fastrtps waits a moment for it (`dds_profiles.xml`), in which rclpy lets no other thread of Python run; then it drops the reply,
rclpy warns, and the client waits for ever. rclpy leaves no other place to send it again than where it is sent.
"""

from __future__ import annotations

import logging
import time
import warnings
from collections.abc import Callable
from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation

log = logging.getLogger(__name__)

PATIENCE = 3.0
"""For so long (s) a reply is sent again. What is lost of a participant's description comes again within that time (the period of
heartbeats in Fast DDS); a client that asks for durability, or another quality that services do not have, is never found."""
_SOON = 0.01  # s

_SENDERS = (
    (rclpy_implementation.Service, "service_send_response"),
    (rclpy_implementation.ActionServer, "send_goal_response"),
    (rclpy_implementation.ActionServer, "send_cancel_response"),
    (rclpy_implementation.ActionServer, "send_result_response"),
)


def insist() -> None:
    """From now on no service and no action of this process drops a reply before it has been sent again for PATIENCE s. Once."""
    warnings.filterwarnings("error", "failed to send response", RuntimeWarning)
    for kind, name in _SENDERS:
        setattr(kind, name, _insistent(getattr(kind, name)))


def _insistent(send: Callable[..., None]) -> Callable[..., None]:
    def send_until_sent(handle: Any, *reply: Any) -> None:
        began = time.monotonic()
        while not _sent(send, handle, *reply):
            waited = time.monotonic() - began
            if waited > PATIENCE:
                log.warning(
                    "reply dropped service=%s reason=DDS knows no way to its client; a client needs the default QoS of services",
                    getattr(handle, "name", "of an action"),
                )
                return
            time.sleep(max(_SOON, waited))

    return send_until_sent


def _sent(send: Callable[..., None], handle: Any, *reply: Any) -> bool:
    try:
        send(handle, *reply)
    except (RuntimeWarning, SystemError) as error:  # the second where rclpy goes on after the first, which Python reports
        if not isinstance(error.__cause__ or error, RuntimeWarning):
            raise
        return False
    return True
