"""The smallest possible service, run as a separate process. `--fault` makes it fail as it starts."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from zarm_contract.errors import InvalidRequest
from zarm_runtime.service import Service, run_service, service_parser


@contextmanager
def start(service: Service) -> Iterator[None]:
    service.starting("nothing to do")
    if service.options.fault == "refusal":
        raise InvalidRequest("this cannot work; do that", field="--fault")
    if service.options.fault == "bug":
        raise ZeroDivisionError("a fault of the service")
    service.ready()
    yield
    sys.stdout.write("closed\n")


parser = service_parser("minimal")
parser.add_argument("--fault", choices=["refusal", "bug"])
sys.exit(run_service("minimal", parser, start))
