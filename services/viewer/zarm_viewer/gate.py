"""Access control of the page: viser's server behind a check of host, origin and token, and TLS.

viser has no hook for that, and a proxy in front of it would leave viser's own port open to every page of the browser.
So its server is built while `websockets.serve` is temporarily replaced. Tested with viser 1.1.1 and websockets 16.1.
"""

from __future__ import annotations

import hmac
import ipaddress
import secrets
import socket
import ssl
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from http import HTTPStatus
from typing import Any
from urllib.parse import urlsplit

import rich
import viser
import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

from zarm_contract.errors import InvalidRequest, Unavailable

_Handler = Callable[[ServerConnection, Request], Response | None]
_BUILDING = threading.Lock()


@dataclass(frozen=True)
class Gate:
    """Where the page is served, and to whom. On loopback, everyone on this machine may open it; otherwise the `token`
    is needed.

    The host in a request must be an address, this machine's name or one of `names`, and its origin the page itself: a
    foreign page in the same browser is refused.
    """

    host: str
    port: int
    tls: ssl.SSLContext | None = None
    token: str | None = None
    names: frozenset[str] = field(default_factory=lambda: frozenset({"localhost", socket.gethostname().lower()}))

    @classmethod
    def at(cls, listen: str, *, tls: ssl.SSLContext | None = None, token: str | None = None) -> Gate:
        """A gate at `HOST:PORT`; if HOST is reachable from other machines, a token is generated unless one is given.
        Raises InvalidRequest.
        """
        host, _, port = listen.rpartition(":")
        host = host.removeprefix("[").removesuffix("]")
        if not host or not port.isdecimal() or int(port) > 65535:
            raise InvalidRequest(f"{listen!r} is not an address; write it like 127.0.0.1:8080", field="--listen")
        local = host == "localhost" or (_is_address(host) and ipaddress.ip_address(host).is_loopback)
        return cls(host, int(port), tls, token or (None if local else secrets.token_urlsafe(24)))

    def address(self, port: int) -> str:
        """The URL to open in the browser."""
        host = socket.gethostname() if self.host in ("0.0.0.0", "::") else self.host  # noqa: S104
        shown = f"[{host}]" if ":" in host else host
        path = f"{self.token}/" if self.token else ""
        return f"{'https' if self.tls else 'http'}://{shown}:{port}/{path}"

    def serve(self, title: str) -> viser.ViserServer:
        """viser's server behind this gate. Raises Unavailable if the port is taken."""
        self._require_free()
        rich.get_console().quiet = True  # viser prints its address without the token
        with _BUILDING:
            serve = websockets.asyncio.server.serve
            setattr(websockets.asyncio.server, "serve", partial(_gated, serve, self))  # noqa: B010 - no such attribute, to mypy
            try:
                return _Server(host=self.host, port=self.port, label=title, verbose=False)
            finally:
                setattr(websockets.asyncio.server, "serve", serve)  # noqa: B010

    def check(self, request: Request) -> Response | None:
        """The refusal of a request, or None; removes the token from its path."""
        host = request.headers.get("Host", "")
        name = (urlsplit(f"//{host}").hostname or "").lower()
        if not (_is_address(name) or name in self.names):
            return _refusal(HTTPStatus.FORBIDDEN, f"this page is not served as {name!r}")
        origin = request.headers.get("Origin")
        if origin is not None and origin != f"{'https' if self.tls else 'http'}://{host}":
            return _refusal(HTTPStatus.FORBIDDEN, "pages from elsewhere may not speak to this one")
        if self.token is not None:
            given, _, rest = request.path.removeprefix("/").partition("/")
            if not hmac.compare_digest(given.encode(), self.token.encode()):
                return _refusal(
                    HTTPStatus.UNAUTHORIZED, "open the whole address that `zarm view` printed, token included"
                )
            request.path = f"/{rest}"
        return None

    def _require_free(self) -> None:
        try:
            with socket.create_server(
                (self.host, self.port), family=socket.AF_INET6 if ":" in self.host else socket.AF_INET
            ):
                pass
        except OSError as error:
            raise Unavailable(
                f"the page cannot be served at {self.host}:{self.port}: {error.strerror}; choose another with --listen"
            ) from error


class _Server(viser.ViserServer):
    """viser's server without sharing: any page could otherwise request a tunnel through viser's makers, past this gate."""

    def request_share_url(self, verbose: bool = True) -> None:
        """Open no tunnel."""


def _gated(serve: Callable[..., Any], gate: Gate, *arguments: Any, process_request: _Handler, **options: Any) -> Any:
    def admit(connection: ServerConnection, request: Request) -> Response | None:
        return gate.check(request) or process_request(connection, request)

    return serve(*arguments, process_request=admit, ssl=gate.tls, **options)


def _refusal(status: HTTPStatus, why: str) -> Response:
    body = f"{why}\n".encode()
    headers = websockets.Headers({"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(body))})
    return Response(status, status.phrase, headers, body)


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True
