"""`ZARM_SECURITY=on`: whether sessions use certificates, and whose."""

from __future__ import annotations

import os

from zarm_contract.errors import InvalidRequest
from zarm_contract.roles import ROLES, Role

RENEWAL_DAYS = 60
"""Within this time of its end a certificate is renewed by `zarm certs`, and a service that starts with it warns."""

PAGE = "page"
"""The name of the web page's certificate, which is not a role on the bus."""


def security_on() -> bool:
    """Whether the bus uses certificates: `ZARM_SECURITY` is `on`, or `off`, the default."""
    setting = os.environ.get("ZARM_SECURITY", "").lower() or "off"
    if setting not in ("on", "off"):
        raise InvalidRequest(f"ZARM_SECURITY={setting} is neither on nor off", field="ZARM_SECURITY")
    return setting == "on"


def client_role() -> Role:
    """The role of a client of the services: `ZARM_ROLE`, by default operator."""
    wanted = os.environ.get("ZARM_ROLE") or "operator"
    role = next((role for role in ROLES if role == wanted), None)
    if role is None:
        raise InvalidRequest(f"ZARM_ROLE={wanted} is not a role; choose one of {', '.join(ROLES)}", field="ZARM_ROLE")
    return role
