"""What a process may be on the bus."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, get_args

Role = Literal[
    "router", "planner", "executor", "servo", "perception", "bridge", "driver", "operator", "agent", "viewer"
]
"""What a process is on the bus; the common name of its certificate."""

ROLES: tuple[Role, ...] = get_args(Role)
SERVICE_ROLES: Mapping[str, Role] = {
    "planner": "planner",
    "executor": "executor",
    "servo": "servo",
    "perception": "perception",
    "ros_bridge": "bridge",
    "leeloo_sim": "driver",
    "physics_sim": "driver",
}
"""The role of each service, by its name on the bus."""

Roles = tuple[Role, ...]

EVERYONE: Roles = tuple(role for role in ROLES if role != "router")
DRIVES: Roles = ("operator", "bridge")
"""Those who make plans, change the scene, and move the robot."""
ACTS: Roles = (*DRIVES, "agent")
"""Those who make and execute plans, change the scene, and move grippers. An agent may do no more."""
