"""The wire is light: any program can import it, and speak it, without the weight of planning or of a terminal."""

from __future__ import annotations

import json
import subprocess
import sys

_PROGRAM = """
import importlib, json, pkgutil, sys
before = set(sys.modules)
library = importlib.import_module(sys.argv[1])
for module in pkgutil.walk_packages(library.__path__, library.__name__ + "."):
    if module.name not in sys.argv[2:]:
        importlib.import_module(module.name)
print(json.dumps(sorted({name.split(".")[0] for name in set(sys.modules) - before} - set(sys.stdlib_module_names))))
"""


def loaded(library: str, *without: str) -> set[str]:
    """The libraries that the modules of one load, but for those of pydantic and yaml."""
    done = subprocess.run(
        [sys.executable, "-c", _PROGRAM, library, *without], capture_output=True, text=True, check=True
    )
    of_pydantic = {"pydantic_core", "annotated_types", "typing_extensions", "typing_inspection"}
    of_yaml = {"cython_runtime"}
    return {name for name in json.loads(done.stdout) if not name.startswith("_")} - of_pydantic - of_yaml


_CONTRACT = {"zarm_contract", "pydantic", "yaml", "zenoh"}
_RUNTIME = _CONTRACT | {"zarm_runtime"}


def test_the_contract_imports_only_pydantic_yaml_and_zenoh() -> None:
    assert loaded("zarm_contract") == _CONTRACT


def test_the_runtime_imports_nothing_else() -> None:
    assert loaded("zarm_runtime", "zarm_runtime.record") == _RUNTIME


def test_whoever_writes_a_record_loads_mcap_too_and_nothing_else() -> None:
    assert loaded("zarm_runtime") == _RUNTIME | {"mcap", "lz4", "zstandard"}
