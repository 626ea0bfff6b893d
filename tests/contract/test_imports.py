"""The contract is light: any program can import it without the weight of planning or of a terminal."""

from __future__ import annotations

import json
import subprocess
import sys

_PROGRAM = """
import json, pkgutil, sys
before = set(sys.modules)
import zarm_contract
for module in pkgutil.walk_packages(zarm_contract.__path__, "zarm_contract."):
    if module.name not in sys.argv[1:]:
        __import__(module.name)
print(json.dumps(sorted({name.split(".")[0] for name in set(sys.modules) - before} - set(sys.stdlib_module_names))))
"""


_LIGHT = {"zarm_contract", "pydantic", "zenoh", "yaml"}


def loaded(*without: str) -> set[str]:
    """The libraries that the contract's modules load, but for those of pydantic and yaml."""
    done = subprocess.run([sys.executable, "-c", _PROGRAM, *without], capture_output=True, text=True, check=True)
    of_pydantic = {"pydantic_core", "annotated_types", "typing_extensions", "typing_inspection"}
    of_yaml = {"cython_runtime"}
    return {name for name in json.loads(done.stdout) if not name.startswith("_")} - of_pydantic - of_yaml


def test_the_contract_imports_pydantic_zenoh_and_yaml_and_nothing_else() -> None:
    assert loaded("zarm_runtime.record") == _LIGHT


def test_whoever_writes_a_record_loads_mcap_too_and_nothing_else() -> None:
    assert loaded() == _LIGHT | {"mcap", "lz4", "zstandard"}
