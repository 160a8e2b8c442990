"""The numbers of a run in the text format of Prometheus."""

from __future__ import annotations

from itertools import groupby

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
#: Names of other numbers, with their help texts.
GAUGES = {
    "plants": "Plants that are watched.",
    "plants_in_alarm": "Plants with an alarm that lasts.",
    "plants_missing": "Plants that are not watched because values are missing.",
    "largest_ratio": "Largest statistic over its threshold among the plants: over 1 is over it.",
    "oldest_age_seconds": "Seconds since the last sample of the plant that has waited longest.",
    "queue": "Messages that wait to be read.",
    "behind": "Events that a sink has not delivered yet.",
    "connected": "Whether a source or sink is connected.",
    "plant_ratio": "Last statistic of a plant over its threshold: over 1 is over it.",
}


def metrics_text(view: View, *, per_plant: bool = False) -> bytes:
    """Return the metrics of a run; with one series for each plant only if ``per_plant`` is set.

    Names begin with ``residua_``; those of counters end in ``_total``.
    """
    numbers = dict(view.counters())
    if per_plant:
        numbers |= {("plant_ratio", (("plant", plant),)): ratio for plant, ratio in view.ratios().items()}
    lines = []
    for family, samples in groupby(sorted(numbers.items()), key=lambda one: one[0][0]):
        counts = family in COUNTERS
        name = f"residua_{family}_total" if counts else f"residua_{family}"
        lines.append(f"# HELP {name} {COUNTERS[family] if counts else GAUGES[family]}")
        lines.append(f"# TYPE {name} {'counter' if counts else 'gauge'}")
        for (_, labels), value in samples:
            inner = ",".join(f'{label}="{_escaped(text)}"' for label, text in labels)
            lines.append(f"{name}{{{inner}}} {float(value)}" if labels else f"{name} {float(value)}")
    return "\n".join([*lines, ""]).encode()


def _escaped(text: str) -> str:
    return text.replace("\\", r"\\").replace("\n", r"\n").replace('"', r"\"")
