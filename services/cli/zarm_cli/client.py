"""The client of a command: which robot it talks to, and requests from its arguments."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from typing import Annotated, TypeVar

import typer

from zarm import connection
from zarm.robot import Robot
from zarm_cli import interrupts
from zarm_cli.output import err
from zarm_contract.codec import decode
from zarm_contract.errors import InvalidRequest
from zarm_contract.keys import Keys
from zarm_contract.messages import Message

Connect = Annotated[str, typer.Option(envvar="ZARM_CONNECT", help="Endpoint of the router.")]
Name = Annotated[
    str | None, typer.Option(envvar="ZARM_NAME", help="Name of the robot on the bus (default: the only one there).")
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one line of JSON: the message on the bus.")]

M = TypeVar("M", bound=Message)
T = TypeVar("T")


class Signals:
    """Signals that interrupt a command: SIGINT and SIGTERM, as in `zarm_cli.interrupts`."""

    def run_interruptibly(self, work: Callable[[], T]) -> T:
        """What `work` returns or raises; raises KeyboardInterrupt at the first signal."""
        return interrupts.run_interruptibly(work)

    def check(self) -> None:
        """Raise KeyboardInterrupt if a signal is pending."""
        interrupts.check()

    def insist(self, awaited: str) -> AbstractContextManager[None]:
        """A block left early only by the third signal; the second one shows what is awaited."""
        return interrupts.insist(
            lambda: err.print(f"zarm: waiting for {awaited}; Ctrl-C again leaves the robot as it is", soft_wrap=True)
        )


SIGNALS = Signals()


@contextmanager
def connected(connect: str, name: str | None) -> Iterator[Robot]:
    """The robot `name`, or the only robot on the bus.

    Raises Unavailable without a router or a robot, InvalidRequest if there are several or the name is invalid.
    """
    with ExitStack() as stack:
        with _naming_the_option():
            found = stack.enter_context(connection.connected(connect, name, interrupts=SIGNALS))
        yield Robot(found)


def keys_of(name: str) -> Keys:
    """The keys of a robot. Raises InvalidRequest for an invalid name."""
    with _naming_the_option():
        return connection.keys_of(name)


@contextmanager
def _naming_the_option() -> Iterator[None]:
    try:
        yield
    except InvalidRequest as error:
        if error.problem.field != "name":
            raise
        raise InvalidRequest(error.problem.message, field="--name") from error


def message(model: type[M], **fields: object) -> M:
    """A message from user input; None is left out. Raises InvalidRequest that names the field."""
    return decode(model, json.dumps({name: value for name, value in fields.items() if value is not None}).encode())


def floats(text: str, option: str, *counts: int) -> list[float]:
    """The numbers of `0.4,-0.2,0.5`; their number must be one of `counts`, if given. Usage error otherwise."""
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        raise typer.BadParameter(f"{text!r} must be comma-separated numbers", param_hint=option) from None
    if counts and len(values) not in counts:
        expected = " or ".join(str(count) for count in counts)
        raise typer.BadParameter(f"{text!r} holds {len(values)} numbers where {expected} are needed", param_hint=option)
    return values


def joints(text: str | None, option: str) -> list[float] | None:
    """The joint vector (rad) of an optional option."""
    return None if text is None else floats(text, option)
