"""`zarm router`: only a router, for machines where the services run separately."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from zarm_cli.interrupts import pause
from zarm_cli.output import facts, out
from zarm_runtime.session import DEFAULT_ENDPOINT, listens_at, resolved_endpoint, router_config, run_router


def router(
    listen: Annotated[
        str | None,
        typer.Option(
            envvar="ZARM_LISTEN",
            help=f"Endpoint to listen at.  [default: {DEFAULT_ENDPOINT}]",
            show_default=False,
        ),
    ] = None,
    link: Annotated[
        list[str] | None,
        typer.Option(metavar="ENDPOINT", help="Endpoint of the router of another machine; repeatable."),
    ] = None,
    config: Annotated[
        Path | None, typer.Option(metavar="FILE", help="A configuration file of Zenoh, such as deploy/router.json5.")
    ] = None,
) -> None:
    """Run only a router, until Ctrl-C or SIGTERM. It restores broken links."""
    settings = router_config(listen, link or (), config=config)
    with suppress(KeyboardInterrupt), run_router(settings):  # the usual end
        endpoints = [("endpoint", endpoint) for endpoint in listens_at(settings)]
        out.print(facts(*endpoints, *(("link", resolved_endpoint(endpoint)) for endpoint in link or ())))
        out.print("The router runs; Ctrl-C stops it.")
        pause()
