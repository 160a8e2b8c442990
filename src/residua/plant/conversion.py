"""Plants from state-space systems of other packages, recognised by their attributes."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from residua.errors import ModelError
from residua.plant.plant import Plant


def plant_from_state_space(
    system: Any,
    *,
    dt: float | None = None,
    inputs: Iterable[str] | str | None = None,
    outputs: Iterable[str] | str | None = None,
    states: Iterable[str] | str | None = None,
    **options: Any,
) -> Plant:
    """Make a plant from any object with the attributes of a linear state-space system.

    Whatever has the attributes ``A``, ``B``, ``C`` and ``D`` will do: python-control's ``StateSpace``,
    ``scipy.signal``'s ``StateSpace``, a residua ``StateSpace``; also a ``scipy.signal`` transfer function,
    which is realised first. Neither package is imported. All inputs become control inputs.

    Parameters
    ----------
    system : object
    dt : float, optional
        The step in seconds (0: continuous), where the system does not say: python-control leaves it open
        with ``dt=None`` (also the default of gains) and ``dt=True``. It cannot contradict the system.
    inputs, outputs, states : sequence of str, optional
        Names; the system's own labels when omitted.
    **options
        Further arguments of :class:`residua.Plant`: ``name``, ``units``, ``operating_point``,
        ``description``.

    Returns
    -------
    Plant

    Raises
    ------
    ModelError
        If the object is not a state-space system, its time base is open and ``dt`` is not given, or ``dt``
        contradicts it.

    Examples
    --------
    >>> from scipy.signal import StateSpace
    >>> from residua.plant import plant_from_state_space
    >>> plant_from_state_space(StateSpace([[0.5]], [[1]], [[1]], [[0]], dt=0.1), name="lag")
    Plant('lag': 1 states, 1 inputs, 1 outputs, 0 disturbances, 0 faults, dt=0.1 s)
    """
    if isinstance(system, Plant):
        raise ModelError("this is a Plant already")
    if not _looks_right(system) and callable(getattr(system, "to_ss", None)):
        system = system.to_ss()
    if not _looks_right(system):
        raise ModelError(
            f"expected a state-space system with matrices A, B, C and D, got {type(system).__name__}; "
            "convert a transfer function to state space first"
        )
    A, B, C, D = (np.asarray(getattr(system, letter)) for letter in "ABCD")
    return Plant(
        A,
        B,
        C,
        D,
        E=getattr(system, "E", None),
        dt=system_step(getattr(system, "dt", None), dt, system),
        inputs=inputs if inputs is not None else system_labels(system, "input", B.shape[-1]),
        outputs=outputs if outputs is not None else system_labels(system, "output", C.shape[0]),
        states=states if states is not None else system_labels(system, "state", A.shape[0]),
        **({"name": system.name} if isinstance(getattr(system, "name", None), str) else {}) | options,
    )


def _looks_right(system: Any) -> bool:
    return all(np.ndim(getattr(system, letter, 0)) == 2 for letter in "ABCD")


def system_labels(system: Any, kind: str, count: int) -> tuple[str, ...] | None:
    """Return python-control's ``input_labels`` or residua's ``inputs``, if they are names."""
    for attribute in (f"{kind}_labels", f"{kind}s"):
        labels = getattr(system, attribute, None)
        if not isinstance(labels, (list, tuple)) or len(labels) != count:
            continue
        if all(isinstance(label, str) for label in labels):
            return tuple(labels)
    return None


def system_step(step: Any, given: float | None, system: Any) -> float:
    """Return the step; SciPy's continuous systems carry ``dt=None``, python-control's ``dt=0``."""
    module = type(system).__module__.partition(".")[0]
    if step is None and module == "scipy":
        step = 0.0
    if step is None or step is True:
        if given is None:
            if step is True:
                raise ModelError("the system is sampled with an unstated step (dt=True): give dt= in seconds")
            raise ModelError(
                "the system does not say its time base (dt=None): give dt= in seconds, or dt=0 for continuous"
            )
        if step is True and given == 0:
            raise ModelError("the system is sampled (dt=True): dt must be a positive step in seconds")
        return given
    if given is not None and given != step:
        raise ModelError(f"dt={given} contradicts the system's own dt={step}")
    return float(step)
