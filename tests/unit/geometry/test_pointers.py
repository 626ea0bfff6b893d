"""Kernels take pointers only to arrays that they were given: numba frees an array of its own as soon as only a pointer is left."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
KERNELS = sorted(path for part in ("libs", "services") for path in (ROOT / part).glob("*/*/kernels/*.py"))


def own_arrays(function: ast.FunctionDef) -> set[str]:
    """The variables to which a function assigns an array that it allocates with NumPy."""
    names: set[str] = set()
    for node in ast.walk(function):
        if isinstance(node, ast.Assign):
            for target in node.targets:
                pairs = [(target, node.value)]
                if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
                    pairs = list(zip(target.elts, node.value.elts, strict=True))
                names |= {
                    name.id
                    for name, value in pairs
                    if isinstance(name, ast.Name) and ast.unparse(value).startswith("np.")
                }
    return names


def pointers_to_own(source: str) -> list[str]:
    """Functions and variables: where a pointer to an array of the function itself is taken."""
    return [
        f"{function.name}: {ast.unparse(call)}"
        for function in ast.walk(ast.parse(source))
        if isinstance(function, ast.FunctionDef)
        for call in ast.walk(function)
        if isinstance(call, ast.Call) and ast.unparse(call.func) == "pointer"
        if ast.unparse(call.args[0]) in own_arrays(function)
    ]


def test_a_pointer_to_an_array_of_its_own_is_found() -> None:
    source = "def f(n, given):\n    a, b = np.empty(n), n\n    g(pointer(a), pointer(given), pointer(b))\n"
    assert pointers_to_own(source) == ["f: pointer(a)"]


@pytest.mark.parametrize("path", KERNELS, ids=[path.stem for path in KERNELS])
def test_no_kernel_takes_a_pointer_to_an_array_of_its_own(path: Path) -> None:
    assert pointers_to_own(path.read_text()) == []
