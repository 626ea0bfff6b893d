"""Stand-ins for what LeRobot imports and a test does without: training, screens, serial ports."""

from __future__ import annotations

import importlib.abc
import importlib.machinery
import sys
import types
from collections.abc import Iterable
from typing import Any

OTHERS = frozenset(
    {
        "accelerate", "cv2", "deepdiff", "diffusers", "einops", "gymnasium", "imageio", "pynput", "rerun", "safetensors", "serial", "termcolor",
        "torchcodec", "torchvision", "transformers", "wandb",
    }
)  # fmt: skip
"""What neither a robot nor a data set needs."""
DATA_SETS = frozenset({"av", "datasets", "jsonlines", "pandas", "pyarrow", "torch"})
"""What only a data set needs."""


class Anything(type):
    """A class that has every attribute, and decorates functions as they are."""

    def __getattr__(cls, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return Anything(name, (), {})

    def __getitem__(cls, _: object) -> Any:
        return cls

    def __or__(cls, _: object) -> Any:
        return object

    __ror__ = __or__

    def __call__(cls, *arguments: Any, **_: Any) -> Any:
        return arguments[0] if len(arguments) == 1 and callable(arguments[0]) else Anything("made", (), {})


class Empty(types.ModuleType):
    """A module that has everything."""

    __path__ = ()

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return Anything(name, (), {})


class Finder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Finds empty modules in place of those with these names."""

    def __init__(self, names: Iterable[str]) -> None:
        self._names = frozenset(names)

    def find_spec(self, name: str, *_: Any) -> importlib.machinery.ModuleSpec | None:
        left_out = name.split(".")[0] in self._names
        return importlib.machinery.ModuleSpec(name, self, is_package=True) if left_out else None

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> types.ModuleType:
        return Empty(spec.name)

    def exec_module(self, module: types.ModuleType) -> None:
        """Nothing is in it."""


def leave_out(names: Iterable[str]) -> None:
    """Import empty modules for these packages from now on."""
    sys.meta_path.insert(0, Finder(names))
