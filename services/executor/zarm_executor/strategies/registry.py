"""The strategies of a robot, and why the others are not available."""

from __future__ import annotations

from zarm_contract.errors import InvalidRequest, Unavailable
from zarm_contract.messages import StrategyInfo
from zarm_executor.strategies.base import Strategy


class StrategyRegistry:
    """Every strategy by its name: those of this robot, and the reason against each other one."""

    def __init__(self) -> None:
        self._strategies: dict[str, Strategy] = {}
        self._ruled_out: dict[str, str] = {}

    def add(self, strategy: Strategy) -> None:
        """This robot has this strategy."""
        self._strategies[strategy.name] = strategy

    def rule_out(self, name: str, reason: str) -> None:
        """This robot cannot have the strategy `name`, for this reason."""
        self._ruled_out[name] = reason

    def find(self, name: str) -> Strategy:
        """The strategy of this name. Raises InvalidRequest if there is none, Unavailable if it is not for this robot."""
        if name in self._ruled_out:
            raise Unavailable(f"{name} is not available: {self._ruled_out[name]}")
        if name not in self._strategies:
            raise InvalidRequest(
                f"there is no strategy {name!r}; this robot has {', '.join(self._strategies)}", field="strategy"
            )
        return self._strategies[name]

    def describe(self) -> tuple[StrategyInfo, ...]:
        """Each strategy, whether it could be switched to now, and why not."""
        reasons = {name: strategy.obstacle() for name, strategy in self._strategies.items()} | self._ruled_out
        return tuple(
            StrategyInfo(name=name, available=reason is None, reason=reason) for name, reason in reasons.items()
        )
