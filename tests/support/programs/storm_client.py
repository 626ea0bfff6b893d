"""A client of a storm: `python storm_client.py ENDPOINT THREADS`.

It says `ready`, reads its requests, one JSON `[number, key, payload]` a line up to an empty line, sends all of them at
once, and writes one JSON `[number, kind, text]` per answer and an empty line at the end; again until its input ends.
"""

from __future__ import annotations

import json
import os
import sys
from concurrent.futures import ThreadPoolExecutor

import zenoh

from zarm_runtime.session import open_client

PATIENCE = 60.0
"""Seconds after which a request counts as unanswered; not a claim about speed."""


def main(endpoint: str, threads: int) -> None:
    os.nice(10)  # the service is tested, not the scheduling of clients
    with open_client(endpoint) as session, ThreadPoolExecutor(threads) as pool:
        sys.stdout.write("ready\n")
        sys.stdout.flush()

        def ask(request: tuple[int, str, str]) -> list[str]:
            number, key, payload = request
            replies = session.get(
                key, payload=payload, timeout=PATIENCE, congestion_control=zenoh.CongestionControl.BLOCK
            )
            return [
                json.dumps([number, "reply", reply.ok.payload.to_string()])
                if reply.ok is not None
                else json.dumps([number, "problem", reply.err.payload.to_string()])
                for reply in replies
            ]

        requests: list[tuple[int, str, str]] = []
        for line in sys.stdin:
            if line != "\n":
                requests.append(json.loads(line))
                continue
            for answers in pool.map(ask, requests):
                sys.stdout.writelines(f"{answer}\n" for answer in answers)
            sys.stdout.write("\n")
            sys.stdout.flush()
            requests.clear()


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
