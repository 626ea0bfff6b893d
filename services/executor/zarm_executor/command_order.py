"""The order in which commands reached the process, which counts where several threads carry them out.

Each command has an `arrival`, a number in that order. Whatever arrived before a stop that has been carried out is too
late, however long it waited.
"""

from __future__ import annotations


class CommandOrder:
    """The arrivals of the latest commands that win over earlier ones."""

    def __init__(self) -> None:
        self._stop = self._end = self._pause = 0.0

    def stop(self, arrival: float) -> None:
        """A stop has been carried out."""
        self._stop = max(self._stop, arrival)

    def end(self, arrival: float) -> None:
        """A command that ends any motion, such as a stop or a cancel, has been carried out."""
        self._end = max(self._end, arrival)

    def pause(self, arrival: float) -> None:
        """A pause has been carried out."""
        self._pause = max(self._pause, arrival)

    def before_stop(self, arrival: float) -> bool:
        """A stop arrived later than this command."""
        return arrival < self._stop

    def before_hold(self, arrival: float) -> bool:
        """A pause, or a command that ends any motion, arrived later than this command."""
        return arrival < max(self._end, self._pause)
