"""Record of the identification of a plant from recordings: method, data, and open questions."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from residua.arrays import index_of
from residua.errors import ModelError
from residua.visible import echo


@dataclass(frozen=True)
class Identification:
    """Record of an identification from recordings; a plant that was given has none.

    Attributes
    ----------
    method : str
    rows : int
        Of the recordings that it is from.
    coloured : tuple of str
        Outputs whose prediction errors are correlated in time: the plant misses some of their dynamics.
    weak_inputs : tuple of str
        Inputs that the past determines almost wholly: the data hardly tell their effect from that of a controller.
    uncertain_gains : tuple of (str, str)
        Outputs and inputs of which the data hardly say the steady gain.

    Examples
    --------
    >>> import residua as rs
    >>> plant = rs.Plant([[0.9]], [[1.0]], [[1.0]], dt=1)
    >>> plant.identification is None
    True
    """

    method: str
    rows: int
    coloured: tuple[str, ...] = ()
    weak_inputs: tuple[str, ...] = ()
    uncertain_gains: tuple[tuple[str, str], ...] = ()

    def __str__(self) -> str:
        return f"identified by {self.method} from {self.rows} rows"


def identification(
    value: Identification | None, inputs: Iterable[str], outputs: Iterable[str]
) -> Identification | None:
    """Return the record of an identification, checked against the channels of the plant."""
    if value is None:
        return None
    if not isinstance(value, Identification):
        raise ModelError(f"identification must be an Identification(method, rows, ...), got {value!r}")
    if not isinstance(value.method, str):
        raise ModelError(f"identification: method must be a text, got {echo(value.method)}")
    if isinstance(value.rows, bool) or not isinstance(value.rows, (int, np.integer)) or value.rows < 1:
        raise ModelError(f"identification: rows must be a whole number of at least one, got {echo(value.rows)}")
    pairs = [_texts(pair, "uncertain_gains") for pair in value.uncertain_gains]
    if any(len(pair) != 2 for pair in pairs):
        raise ModelError(f"identification: uncertain_gains must be pairs (output, input), got {echo(pairs)}")
    inputs, outputs = tuple(inputs), tuple(outputs)
    coloured, weak = _texts(value.coloured, "coloured"), _texts(value.weak_inputs, "weak_inputs")
    for name in coloured:
        index_of(name, outputs, "identification: coloured output")
    for name in weak:
        index_of(name, inputs, "identification: weak input")
    for output, given in pairs:
        index_of(output, outputs, "identification: uncertain gain of output")
        index_of(given, inputs, "identification: uncertain gain of input")
    return Identification(value.method, int(value.rows), coloured, weak, tuple((a, b) for a, b in pairs))


def _texts(value: object, what: str) -> tuple[str, ...]:
    """Return names as a tuple, the form in files."""
    if isinstance(value, str) or not isinstance(value, Iterable) or not all(isinstance(one, str) for one in value):
        raise ModelError(f"identification: {what} must hold names of channels, got {echo(value)}")
    return tuple(value)
