"""Specifications as exported programs, and what these are to leave."""

from __future__ import annotations

import numpy as np

from residua.decide.directional import candidates_at
from residua.export.monitor_program import DOUBLE, MonitorProgram, Precision, specification_program
from residua.monitor.running import Decisions
from residua.monitor.specification import Specification


def exported(spec: Specification, inputs: int, precision: Precision = DOUBLE) -> MonitorProgram:
    names = tuple(f"c{k}" for k in range(spec.B.shape[1]))
    program = specification_program(spec, inputs, precision)
    groups = spec.isolation.groups
    return MonitorProgram(
        program, precision, "example", names[:inputs], names[inputs:], ("",) * len(names), groups, 1.0, "test", (), spec
    )


def expected(spec: Specification, decisions: Decisions) -> np.ndarray:
    """Return what C leaves of the decisions on the first plant."""
    one, tested = decisions, decisions.tested
    alarm, usable = tested.alarm[0], tested.usable[0]
    known = ~np.isnan(one.residuals[0]).any(axis=1)
    columns = [
        np.where(known[:, None], one.residuals[0], 0.0),
        np.where(usable, tested.statistic[0], 0.0)[:, None],
        known[:, None],
        usable[:, None],
        alarm[:, None],
    ]
    named = spec.isolation.compiled
    if named is not None and named.bases:
        scores = np.where((alarm & usable)[:, None], one.named.scores[0], 0.0)
        scores = np.where(np.isnan(scores), 0.0, scores)
        groups = spec.isolation.groups
        dimensions = tuple(basis.shape[1] for basis in named.bases)
        best = np.zeros(len(alarm))
        for k in np.flatnonzero(scores.any(axis=1)):
            best[k] = 1 + groups.index(candidates_at(scores[k], groups, dimensions)[0].faults)
        columns += [best[:, None], scores]
    return np.hstack(columns)
