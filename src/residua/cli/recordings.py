"""Recordings of a command: read by its arguments, with notes in its words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from residua.cli import screen
from residua.cli.guard import in_cli_words
from residua.errors import DataError, ModelError, SettingError
from residua.monitor import Monitor
from residua.monitor.inputs import with_channels
from residua.plant import Plant
from residua.recording.matching import required_columns
from residua.recording.recording import Recording, read_recording
from residua.visible import listed


def plant_of(watch: Monitor) -> Plant:
    """Return the plant of a monitor, sampled if its step is known."""
    try:
        return watch.generator.plant
    except ModelError:
        return watch.design.plant


def read(path: Path, plant: Plant | None, arguments: Mapping[str, Any]) -> Recording:
    """Read a recording for the channels of a plant; without one, every column as an output."""
    with screen.reading(path):
        recording = read_recording(path, plant, **arguments)
    return replace(recording, notes=tuple(map(in_cli_words, recording.notes)))


def read_channels(
    paths: Sequence[Path], inputs: Sequence[str], outputs: Sequence[str], arguments: Mapping[str, Any]
) -> list[Recording]:
    """Read recordings, with the inputs in ``u`` and the outputs in ``y``.

    Without outputs all other columns of the first recording are outputs.
    """
    both = sorted(set(inputs) & set(outputs))
    if both:
        them = "it" if len(both) == 1 else "them"
        raise SettingError(f"{listed(both)} cannot be an input and an output: leave {them} out of one")
    recordings = []
    for path in paths:
        one = read(path, _stand_in(inputs, outputs) if outputs else None, arguments)
        if not outputs:
            advice = "give --inputs the names of columns"
            found = required_columns(inputs, tuple(one.columns), path.name, advice=advice)
            outputs = [name for name in one.columns if name not in found.values()]
            if not outputs:
                raise DataError(f"{path}: every column is an input; leave the outputs out of --inputs")
        recordings.append(with_channels(one, _stand_in(inputs, outputs)))
    return recordings


def _stand_in(inputs: Sequence[str], outputs: Sequence[str]) -> Plant:
    """Return a plant with these channels and no step, so that only these columns are read."""
    zeros = np.zeros((1, len(inputs))), np.zeros((len(outputs), 1))
    return Plant([[-1.0]], zeros[0], zeros[1], inputs=inputs, outputs=outputs)


__all__ = ["plant_of", "read", "read_channels"]
