"""Finds out what listens at an address where no session could be opened."""

from __future__ import annotations

import socket
import ssl
from typing import Literal

_SECONDS = 1.0

Listener = Literal["nobody", "silent", "tls", "other"]
"""`silent` accepts connections and sends nothing, like a process that hangs; `tls` requires or presents certificates.
"""


def what_listens(host: str, port: int) -> Listener:
    """Probe by starting a TLS handshake, without trust and without sending data."""
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
