"""Connections that lead to nothing, as many as a server accepts: `python flood.py HOST PORT`, until it is killed."""

from __future__ import annotations

import socket
import sys
import threading
import time

AT_ONCE = 100
"""More than a router of zarm's handles in ten seconds."""


def knock(host: str, port: int) -> None:
    """Connect, send something that is not TLS, and wait until the other end closes; again and again."""
    while True:
        try:
            with socket.create_connection((host, port), 10.0) as connection:
                connection.sendall(b"no handshake" * 10)
                connection.recv(100)
        except OSError:
            time.sleep(0.01)


if __name__ == "__main__":
    for _ in range(AT_ONCE):
        threading.Thread(target=knock, args=(sys.argv[1], int(sys.argv[2]))).start()
