"""Metrics for Prometheus over HTTP; off by default, and then the library is not even loaded."""

from __future__ import annotations

import logging
import re
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import accumulate
from typing import TYPE_CHECKING, Any, Literal

from zarm_contract.errors import InvalidRequest, Unavailable

if TYPE_CHECKING:
    from prometheus_client import CollectorRegistry, Metric

log = logging.getLogger(__name__)

Kind = Literal["counter", "gauge"]
Histogram = tuple[Sequence[int], float]
"""The number of values in each bucket, and the sum of all."""


DURATIONS = (0.001, 0.002, 0.003, 0.004, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 30.0)
"""Bucket bounds (s) of the histograms of `time`: a plan usually takes 5 ms, and its deadline is 5 s."""


class Metrics:
    """The metrics of one robot. This base class records nothing, for use when metrics are off.

    Names follow Prometheus: counters without `_total`, times in seconds. `what` is a sentence for the reader.
    """

    def count(self, name: str, what: str, by: int = 1, **labels: str) -> None:
        """Add to a counter; 0 makes it known before anything is counted, as alerts on its increase need."""

    def time(self, name: str, what: str, seconds: float, **labels: str) -> None:
        """Add a duration to a histogram."""

    def read(self, kind: Kind, name: str, what: str, value: Callable[[], float | None], **labels: str) -> None:
        """Call `value`, in its own thread, whenever metrics are read; None: no value now."""

    def read_histogram(self, name: str, what: str, bounds: Sequence[float], value: Callable[[], Histogram]) -> None:
        """The same for a histogram whose numbers are kept by a loop that must not wait."""


class _Exported(Metrics):
    """The metrics of one robot among all those of a process."""

    def __init__(self, robot: str, readings: _Readings) -> None:
        self._robot = robot
        self._all = readings

    def count(self, name: str, what: str, by: int = 1, **labels: str) -> None:
        from prometheus_client import Counter

        self._all.metric(Counter, name, what, ("robot", *labels)).labels(robot=self._robot, **labels).inc(by)

    def time(self, name: str, what: str, seconds: float, **labels: str) -> None:
        from prometheus_client import Histogram

        histogram = self._all.metric(Histogram, name, what, ("robot", *labels), buckets=DURATIONS)
        histogram.labels(robot=self._robot, **labels).observe(seconds)

    def read(self, kind: Kind, name: str, what: str, value: Callable[[], float | None], **labels: str) -> None:
        from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

        def sample(family: Any) -> None:
            if (now := value()) is not None:
                family.add_metric((self._robot, *labels.values()), now)

        make = CounterMetricFamily if kind == "counter" else GaugeMetricFamily
        self._all.add(name, lambda: make(name, what, labels=("robot", *labels)), sample)

    def read_histogram(self, name: str, what: str, bounds: Sequence[float], value: Callable[[], Histogram]) -> None:
        from prometheus_client.core import HistogramMetricFamily

        ends = (*map(str, bounds), "+Inf")

        def sample(family: Any) -> None:
            counts, total = value()
            family.add_metric((self._robot,), list(zip(ends, accumulate(counts), strict=True)), total)

        self._all.add(name, lambda: HistogramMetricFamily(name, what, labels=("robot",)), sample)


class _Readings:
    """The metrics of one process: counted in a `metric`, or evaluated when read."""

    def __init__(self, registry: CollectorRegistry) -> None:
        self._registry = registry
        self._metrics: dict[str, Any] = {}
        self._families: dict[str, tuple[Callable[[], Metric], list[Callable[[Any], None]]]] = {}
        self._lock = threading.Lock()
        registry.register(self)

    def metric(self, make: Callable[..., Any], name: str, what: str, labels: Sequence[str], **options: Any) -> Any:
        """The counter or histogram of this name, created if necessary."""
        with self._lock:
            if name not in self._metrics:
                self._metrics[name] = make(name, what, labels, registry=self._registry, **options)
            return self._metrics[name]

    def add(self, name: str, make: Callable[[], Metric], sample: Callable[[Any], None]) -> None:
        """Make `sample` add to a family, which several robots share, whenever metrics are read."""
        with self._lock:
            self._families.setdefault(name, (make, []))[1].append(sample)

    def collect(self) -> Iterator[Metric]:
        """The metrics evaluated now; called by the library."""
        with self._lock:
            families = [(make, samples.copy()) for make, samples in self._families.values()]
        for make, samples in families:
            family = make()
            for sample in samples:
                sample(family)
            yield family


@contextmanager
def serve_metrics(where: str | None) -> Iterator[Callable[[str], Metrics]]:
    """A factory for the Metrics of a robot, served at `http://<where>/metrics` as long as the block lasts.

    `where` is `host:port`; None: metrics are off. Raises InvalidRequest for an invalid address, and Unavailable if the
    port is taken or the library is missing.
    """
    if where is None:
        yield lambda _robot: Metrics()
        return
    found = re.fullmatch(r"\[?([^\[\]]+)\]?:(\d{1,5})", where)
    if found is None or int(found[2]) > 65535:
        raise InvalidRequest(
            f"{where!r} is not an address for metrics; write it like 127.0.0.1:9464", field="--metrics"
        )
    try:
        from prometheus_client import CollectorRegistry, ProcessCollector, start_http_server
    except ImportError as error:
        raise Unavailable(
            "metrics need prometheus-client; install it with `pip install 'zarm[metrics]'`, or leave out --metrics and "
            "ZARM_METRICS"
        ) from error
    registry = CollectorRegistry()
    readings = _Readings(registry)
    ProcessCollector(registry=registry)
    try:
        server, thread = start_http_server(int(found[2]), found[1], registry)
    except OSError as error:
        raise Unavailable(
            f"cannot serve metrics at {where}: {error.strerror or error}; choose another with --metrics or ZARM_METRICS"
        ) from error
    log.info("metrics url=http://%s/metrics", where)
    try:
        yield lambda robot: _Exported(robot, readings)
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
