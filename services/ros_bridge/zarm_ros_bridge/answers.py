"""Replies of services: an error becomes a message in the response, and never reaches rclpy."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

from zarm_contract.errors import InternalError, ZarmError

log = logging.getLogger(__name__)

LONGEST_MESSAGE = 2000
"""Most characters of a message; it may quote client input of any length."""

Handler = Callable[[Any, Any], str]
"""`handler(request, response)` fills in the response and returns the success message, or raises ZarmError; what it has
filled in by then stays.
"""


def with_message(handler: Handler) -> Callable[[Any, Any], Any]:
    """A service that answers with `success` and `message`."""

    def answer(request: Any, response: Any) -> Any:
        response.success, response.message = _outcome(handler, request, response)
        return response

    return answer


def with_error_msg(handler: Handler) -> Callable[[Any, Any], Any]:
    """A service that answers with the error in `error_msg`, and with `success` if its type has that; the success
    message is not sent.
    """

    def answer(request: Any, response: Any) -> Any:
        success, text = _outcome(handler, request, response)
        response.error_msg.data = "" if success else text
        if hasattr(response, "success"):
            response.success = success
        return response

    return answer


def without_words(handler: Handler) -> Callable[[Any, Any], Any]:
    """A service whose response has no field for errors: its response is then empty, and the reason is logged."""

    def answer(request: Any, response: Any) -> Any:
        success, text = _outcome(handler, request, response)
        if not success:
            log.warning("answered with nothing request=%s reason=%s", type(request).__name__, text.replace("\n", " "))
        return response

    return answer


def _outcome(handler: Handler, request: Any, response: Any) -> tuple[bool, str]:
    try:
        return True, handler(request, response)
    except ZarmError as error:
        return False, shortened(str(error))
    except Exception:  # as on the bus, one request fails and the service continues; in rclpy it would end the thread
        log.exception("handler failed request=%s", type(request).__name__)
        return False, str(InternalError("the ROS bridge failed on this request; its log has the trace"))


def shortened(text: str) -> str:
    """The text; of one longer than MOST, its beginning and its end, which contains the remedy and the field."""
    return (
        text if len(text) <= LONGEST_MESSAGE else f"{text[: LONGEST_MESSAGE // 2]} ... {text[-LONGEST_MESSAGE // 2 :]}"
    )
