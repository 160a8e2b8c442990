"""The numbers of a run in the text format of Prometheus."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector

from residua.live.view import View

#: Content type.
CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"
#: Names in :meth:`View.counters` that only grow, with their help texts.
COUNTERS = {
    "messages": "Messages that sources have brought.",
    "dropped": "Messages or readings that were dropped.",
    "rows": "Samples that a monitor has judged.",
    "events": "Events.",
    "commits": "Transactions of the store.",
    "delivered": "Events that a sink has delivered.",
    "delivery_failures": "Deliveries that failed, each to be tried again.",
    "given_up": "Events that a receiver refused for good and that were given up.",
}
#: Names of other numbers, with their outside names and help texts.
GAUGES = {
    "plants": ("plants", "Plants that are watched."),
    "plants_in_alarm": ("plants_in_alarm", "Plants with an alarm that lasts."),
    "plants_missing": ("plants_missing", "Plants that are not watched because values are missing."),
    "largest_ratio": ("largest_ratio", "Largest statistic over its threshold among the plants: over 1 is over it."),
    "oldest_age": ("oldest_age_seconds", "Seconds since the last sample of the plant that has waited longest."),
    "queue": ("queue", "Messages that wait to be read."),
    "behind": ("behind", "Events that a sink has not delivered yet."),
    "connected": ("connected", "Whether a source or sink is connected."),
}

Numbers = Mapping[tuple[str, tuple[tuple[str, str], ...]], float]


def metrics_text(view: View, *, per_plant: bool = False) -> bytes:
    """Return the metrics of a run; with one series for each plant only if ``per_plant`` is set.

    Names begin with ``residua_``; those of counters end in ``_total``.
    """
    registry = CollectorRegistry(auto_describe=False)
    registry.register(_Numbers(view.counters(), view.ratios() if per_plant else {}))
    return generate_latest(registry)


class _Numbers(Collector):
    def __init__(self, numbers: Numbers, ratios: Mapping[str, float]) -> None:
        self._numbers, self._ratios = numbers, ratios

    def collect(self) -> Iterator[Metric]:
        families: defaultdict[str, list[tuple[dict[str, str], float]]] = defaultdict(list)
        for (name, labels), value in sorted(self._numbers.items()):
            families[name].append((dict(labels), value))
        for name, samples in families.items():
            labels = sorted({label for one, _ in samples for label in one})
            family = _family(name, labels)
            for one, value in samples:
                family.add_metric([one.get(label, "") for label in labels], value)
            yield family
        if self._ratios:
            each = GaugeMetricFamily(
                "residua_plant_ratio",
                "Last statistic of a plant over its threshold: over 1 is over it.",
                labels=["plant"],
            )
            for plant, ratio in sorted(self._ratios.items()):
                each.add_metric([plant], ratio)
            yield each


def _family(name: str, labels: list[str]) -> CounterMetricFamily | GaugeMetricFamily:
    if name in COUNTERS:
        return CounterMetricFamily(f"residua_{name}", COUNTERS[name], labels=labels)
    called, text = GAUGES[name]
    return GaugeMetricFamily(f"residua_{called}", text, labels=labels)
