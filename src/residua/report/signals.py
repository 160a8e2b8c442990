"""Charts of the measurements, and of the model's predictions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from residua.report.choosing import signal_order
from residua.report.decimate import Bins
from residua.report.text import rounded, visible
from residua.words import listing, some

if TYPE_CHECKING:
    from residua.monitor.diagnosis import Diagnosis

#: Measured outputs that are shown at once; the others, and the inputs, are behind a click.
SHOWN_SIGNALS = 4


def signal_charts(diagnosis: Diagnosis, bins: Bins) -> list[dict[str, Any]]:
    """Return the charts of the outputs, with their predictions if there are any, and then of the inputs."""
    if not len(diagnosis.signals):
        return []
    plant = diagnosis.generator.plant
    m, predicted = len(plant.inputs), diagnosis.predictions
    charts = []
    for j in signal_order(diagnosis):
        name = plant.outputs[j]
        chart = _chart(diagnosis, name, "output", m + j, bins)
        if name in predicted:
            chart["y"].append(rounded(bins.extremes(predicted[name])))
            chart["names"].append("model")
            seen = predicted[name][diagnosis.decided]
            seen = np.concatenate([seen, diagnosis.signals[:, m + j]])
            seen = seen[np.isfinite(seen)]
            chart["limits"] = [float(seen.min()), float(seen.max())] if seen.size else None
        charts.append(chart)
    return charts + [_chart(diagnosis, name, "input", k, bins) for k, name in enumerate(plant.inputs)]


def _chart(diagnosis: Diagnosis, name: str, role: str, column: int, bins: Bins) -> dict[str, Any]:
    return {
        "kind": "signal",
        "role": role,
        "label": visible(name),
        "unit": visible(diagnosis.generator.plant.units.get(name, "")),
        "y": [rounded(bins.extremes(diagnosis.signals[:, column]))],
        "names": ["measured"],
    }


def signal_text(diagnosis: Diagnosis) -> str:
    """Return the meaning of the predictions, and the outputs without one."""
    if not len(diagnosis.signals):
        return ""
    plant = diagnosis.generator.plant
    predicted = diagnosis.predictions
    if not predicted:
        return (
            "This filter predicts no output, so only the measurements are shown; the residuals show how they differ "
            "from the model."
        )
    text = (
        "Model: the filter's prediction of each output from all earlier samples and the present inputs. It follows the "
        "measurements, so look for a small gap that lasts: the residual below is that gap, enlarged."
    )
    without = [name for name in plant.outputs if name not in predicted]
    return text + (f" The filter predicts no {some(without)}." if without else "")


def shown_text(diagnosis: Diagnosis) -> str:
    """Describe the outputs that are drawn first, if not all are."""
    order = signal_order(diagnosis)
    if len(order) <= SHOWN_SIGNALS or diagnosis.main_alarm is None:
        return ""
    names = listing(diagnosis.generator.plant.outputs[j] for j in order[:SHOWN_SIGNALS])
    return f" Drawn first: {names}, which moved most in the main alarm."
