"""What a record contains: the recorded keys of a robot, and the message class of each."""

from __future__ import annotations

from typing import Any

from zarm_contract.key import Published
from zarm_contract.keys import Keys, every_key
from zarm_contract.messages import Message


class Recorded:
    """The recorded keys of one robot, unless told otherwise without those that are recorded with the scene alone.

    `keys` are they by key expression (goals are the family `executor/goal/*`, and grippers another one).
    """

    def __init__(self, keys: Keys, *, scene: bool = False) -> None:
        without = {None} if scene else {None, "with the scene"}
        recorded = [
            key.of_robot(keys.robot)
            for key in every_key()
            if isinstance(key, Published) and key.recorded not in without
        ]
        self.keys: dict[str, Published[Any]] = {key: key for key in recorded}
        self._families = [(key, key.partition("*")) for key in recorded if "*" in key]

    def key(self, expression: str) -> Published[Any] | None:
        """The recorded key with this key expression; None if it is not recorded."""
        known = self.keys.get(expression)
        if known is not None:
            return known
        return next(
            (
                key
                for key, (before, _, after) in self._families
                if expression.startswith(before) and expression.endswith(after)
            ),
            None,
        )

    def model(self, expression: str) -> type[Message] | None:
        """The class of the messages on a key; None if it is not recorded."""
        key = self.key(expression)
        return None if key is None else key.model
