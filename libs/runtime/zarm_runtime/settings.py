"""Every environment variable that zarm reads, for `docs/reference/settings.md`."""

from __future__ import annotations

from typing import NamedTuple


class Setting(NamedTuple):
    """One variable; `option` is the command-line option that overrides it, if there is one."""

    name: str
    default: str
    what: str
    option: str | None = None


SETTINGS = (
    Setting("ZARM_CONNECT", "`tcp/127.0.0.1:7447`", "The endpoint of the router.", "--connect"),
    Setting(
        "ZARM_LISTEN", "`tcp/127.0.0.1:7447`", "Where the router of `zarm up` or `zarm router` listens.", "--listen"
    ),
    Setting(
        "ZARM_ROBOT", "`doosan_m1013`", "The robot: the name of a descriptor, or the path of a `.yaml` file.", "--robot"
    ),
    Setting(
        "ZARM_NAME",
        "services: the name in the descriptor; clients: the only robot on the bus",
        "The name of the robot on the bus.",
        "--name",
    ),
    Setting(
        "ZARM_STRATEGY", "as in the descriptor", "The control strategy that the executor starts with.", "--strategy"
    ),
    Setting(
        "ZARM_STATE", "`$XDG_STATE_HOME/zarm`, else `~/.local/state/zarm`", "The folder for saved state.", "--state"
    ),
    Setting("ZARM_MESHES", "none", "The folders whose mesh files the scene may use, separated by `:`.", "--meshes"),
    Setting("ZARM_SECURITY", "`off`", "`on`: TLS with certificates, and the rights of a role for every process."),
    Setting("ZARM_CERTS", "none", "The folder with the certificates; needed with `ZARM_SECURITY=on`."),
    Setting(
        "ZARM_ROLE", "`operator`", "The role of a client: `operator`, `viewer`, or another one with a certificate."
    ),
    Setting(
        "ZARM_VIEW", "`127.0.0.1:8017`", "Where the page in the browser is served: `host:port`.", "--listen, --view-at"
    ),
    Setting(
        "ZARM_RECORDS",
        "the viewer's --state",
        "The executor's folder for saved state, as the viewer reads it: records of faults.",
    ),
    Setting("ZARM_VIEW_TOKEN", "random", "The token in the page's address, unless that is on loopback."),
    Setting(
        "ZARM_METRICS", "off", "The `host:port` at which Prometheus reads the metrics of the service.", "--metrics"
    ),
    Setting(
        "ZARM_SIM_SPEED",
        "1",
        "How many times as fast as real time a simulated robot and all programs around it run, 1 to 20.",
        "--speed",
    ),
    Setting("ZARM_LOG", "`INFO`", "The log level: `DEBUG`, `INFO`, `WARNING` or `ERROR`."),
    Setting("ZARM_LOG_FORMAT", "`text`", "`json`: every line of the log is a JSON object."),
    Setting("ZARM_COLOUR", "off", "`1`: colour the name of the service in the log."),
)
