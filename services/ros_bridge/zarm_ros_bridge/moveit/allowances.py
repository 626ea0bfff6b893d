"""The allowed collision matrix: who may touch whom."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

from moveit_msgs.msg import MoveItErrorCodes as Val

from zarm_ros_bridge.moveit.error_codes import Refusal


@dataclass(frozen=True)
class Allowances:
    """What may touch everything, by name, and the `pairs` of others that may touch each other."""

    whole: frozenset[str]
    pairs: frozenset[frozenset[str]]

    @classmethod
    def of(cls, matrix: Any) -> Allowances:
        """Those of a message. Raises Refusal for one that is not square."""
        names = list(matrix.entry_names)
        rows = [list(entry.enabled) for entry in matrix.entry_values]
        if len(rows) != len(names) or any(len(row) != len(names) for row in rows):
            raise Refusal(
                Val.FAILURE,
                f"{len(names)} names need as many rows of as many values",
                "allowed_collision_matrix.entry_values",
            )
        whole = {
            name
            for name, allowed in zip(matrix.default_entry_names, matrix.default_entry_values, strict=False)
            if allowed and name not in names
        }
        for i, name in enumerate(names):
            others = [rows[i][j] or rows[j][i] for j in range(len(names)) if j != i]
            if others and all(others) and rows[i][i]:
                whole.add(name)
        pairs = {
            frozenset((names[i], names[j]))
            for i, j in itertools.combinations(range(len(names)), 2)
            if (rows[i][j] or rows[j][i]) and not {names[i], names[j]} & whole
        }
        return cls(frozenset(whole), frozenset(pairs))
