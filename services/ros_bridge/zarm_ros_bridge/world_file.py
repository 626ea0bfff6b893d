"""A scene in a file, as `zarm scene save` writes it."""

from __future__ import annotations

import json
from pathlib import Path

import yaml

from zarm_contract.codec import decode
from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import LoadScene


def read_world(file: str) -> LoadScene:
    """The objects in a YAML file `objects: [...]`, in place of those of the present scene. Raises InvalidRequest."""
    try:
        data = yaml.safe_load(Path(file).read_bytes())
    except (OSError, ValueError) as error:  # a null character in the path, too
        raise InvalidRequest(f"cannot read {file!r}: {getattr(error, 'strerror', None) or error}") from error
    except yaml.YAMLError as error:
        raise InvalidRequest(f"{file} is no YAML: {' '.join(str(error).split())}") from error
    if not isinstance(data, dict) or set(data) != {"objects"}:
        raise InvalidRequest(f"{file} must be `objects:` and a list, as `zarm scene save` writes it")
    try:
        return decode(LoadScene, json.dumps({"op": "load", **data}, default=str).encode())
    except InvalidRequest as error:
        raise InvalidRequest(f"{file}: {error.problem.message}", field=error.problem.field) from error
