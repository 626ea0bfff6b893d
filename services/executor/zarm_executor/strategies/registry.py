"""The strategies of a robot, and why the others are not available."""

from __future__ import annotations

from zarm_contract.errors import InvalidRequest, Unavailable
from zarm_contract.messages import StrategyInfo
from zarm_executor.strategies.base import Strategy


class StrategyRegistry:
    """All strategies by name: those of this robot, and for each other one why it is unavailable."""

    def __init__(self) -> None:
        self._strategies: dict[str, Strategy] = {}
        self._ruled_out: dict[str, str] = {}

    def add(self, strategy: Strategy) -> None:
        """Add a strategy of this robot."""
        self._strategies[strategy.name] = strategy

    def rule_out(self, name: str, reason: str) -> None:
        """Note why this robot cannot have the strategy `name`."""
        self._ruled_out[name] = reason

    def find(self, name: str) -> Strategy:
        """The strategy of this name. Raises InvalidRequest if there is none, Unavailable if this robot cannot have it."""
        if name in self._ruled_out:
            raise Unavailable(f"{name} is not available: {self._ruled_out[name]}")
        if name not in self._strategies:
            raise InvalidRequest(
                f"there is no strategy {name!r}; this robot has {', '.join(self._strategies)}", field="strategy"
            )
        return self._strategies[name]

    def describe(self) -> tuple[StrategyInfo, ...]:
        """Each strategy, whether it can be switched to now, and why not."""
        reasons = {name: strategy.obstacle() for name, strategy in self._strategies.items()} | self._ruled_out
        return tuple(
            StrategyInfo(name=name, available=reason is None, reason=reason) for name, reason in reasons.items()
        )
