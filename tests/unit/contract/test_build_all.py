"""When what reads and writes messages is built: a command builds what it uses, a service all of it before it is ready."""

from __future__ import annotations

import subprocess
import sys

PROGRAM = """
from zarm_contract.codec import build_all, encode
from zarm_contract.messages import Nothing, Plan, Scene
print(Plan.__pydantic_complete__)
encode(Nothing())
print(Plan.__pydantic_complete__)
build_all()
print(Plan.__pydantic_complete__, Scene.__pydantic_complete__)
"""


def test_messages_are_built_when_they_are_used_or_all_at_once() -> None:
    said = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True, timeout=60)
    assert said.stdout.split() == ["False", "False", "True", "True"]
