"""A client with many simultaneous requests: `greedy_client.py ENDPOINT KEY COUNT`, the request on stdin.

It sends COUNT copies of the request at once, plan requests with the ids `greedy-0`, `greedy-1`, …, and prints a line of
JSON for each answer.
"""

from __future__ import annotations

import json
import os
import sys
import threading
from typing import Any

from zenoh import KeyExpr

from zarm_contract.codec import decode
from zarm_contract.errors import ZarmError
from zarm_contract.key import Query
from zarm_contract.keys import Keys
from zarm_contract.messages import Plan, PlanRequest
from zarm_runtime.bus import Bus


def main() -> None:
    endpoint, expression, count = sys.argv[1], sys.argv[2], int(sys.argv[3])
    key: Query[Any, Any] = next(one.at(expression) for one in (Keys.plan, Keys.ik) if KeyExpr(one).includes(expression))
    request = decode(key.request, sys.stdin.buffer.read())
    with Bus(endpoint) as bus:

        def ask(number: int) -> None:
            named = (
                request.model_copy(update={"request_id": f"greedy-{number}"}) if key.request is PlanRequest else request
            )
            try:
                answer = bus.call(key, named, timeout=120)
            except ZarmError as error:
                line: dict[str, object] = {"code": error.code, "message": str(error)}
            else:
                line = {"code": "ok", "optimize": answer.timings.optimize if isinstance(answer, Plan) else 0.0}
            os.write(1, f"{json.dumps(line)}\n".encode())  # in one piece, though others write as well

        threads = [threading.Thread(target=ask, args=(number,)) for number in range(count)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()


if __name__ == "__main__":
    main()
