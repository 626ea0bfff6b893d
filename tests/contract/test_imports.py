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
    __import__(module.name)
print(json.dumps(sorted({name.split(".")[0] for name in set(sys.modules) - before} - set(sys.stdlib_module_names))))
"""


def test_the_contract_imports_pydantic_zenoh_and_yaml_and_nothing_else() -> None:
    done = subprocess.run([sys.executable, "-c", _PROGRAM], capture_output=True, text=True, check=True)
    loaded = {name for name in json.loads(done.stdout) if not name.startswith("_")}
    of_pydantic = {"pydantic_core", "annotated_types", "typing_extensions", "typing_inspection"}
    of_yaml = {"cython_runtime"}
    assert loaded - of_pydantic - of_yaml == {"zarm_contract", "pydantic", "zenoh", "yaml"}
