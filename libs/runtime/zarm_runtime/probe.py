"""Finds out what listens at an address where no session could be opened."""

from __future__ import annotations

import socket
import ssl
from typing import Literal

_SECONDS = 1.0

Listener = Literal["nobody", "silent", "tls", "other"]
"""`silent` takes connections and says nothing, as a process that hangs does; `tls` wants certificates, or shows one."""


def what_listens(host: str, port: int) -> Listener:
    """Ask by beginning a TLS handshake, in which nobody is trusted and nothing is said."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    try:
        plain = socket.create_connection((host, port), _SECONDS)
    except OSError:
        return "nobody"
    with plain:
        try:
            context.wrap_socket(plain).close()
        except TimeoutError:
            return "silent"
        except OSError:
            return "other"
    return "tls"
