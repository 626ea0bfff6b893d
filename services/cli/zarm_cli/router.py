"""`zarm router`: a router of the bus and nothing else, for machines where the services run apart."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from zarm_cli.interrupts import pause
from zarm_cli.output import facts, out
from zarm_runtime.session import DEFAULT_ENDPOINT, listens_at, router_config, run_router, spoken


def router(
    listen: Annotated[
        str | None,
        typer.Option(
            envvar="ZARM_LISTEN",
            help=f"Where it listens; left out: where the file says.  [default: {DEFAULT_ENDPOINT}]",
            show_default=False,
        ),
    ] = None,
    link: Annotated[
        list[str] | None,
        typer.Option(metavar="ENDPOINT", help="The router of another machine, to make one bus; may be given again."),
    ] = None,
    config: Annotated[
        Path | None, typer.Option(metavar="FILE", help="A configuration of Zenoh's, such as deploy/router.json5.")
    ] = None,
) -> None:
    """Run a router alone, until Ctrl-C or SIGTERM. A link that breaks is made again by itself."""
    settings = router_config(listen, link or (), config=config)
    with suppress(KeyboardInterrupt), run_router(settings):  # the ordinary end
        endpoints = [("endpoint", endpoint) for endpoint in listens_at(settings)]
        out.print(facts(*endpoints, *(("link", spoken(endpoint)) for endpoint in link or ())))
        out.print("The router runs; Ctrl-C stops it.")
        pause()
