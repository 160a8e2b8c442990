"""Monitors of banks and of groups of residuals, and what their exports are to leave."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

import residua as rs
from bank_examples import hand_made_bank, recording, sampled_plant
from export_examples import expected
from residua.decide import Directional, MultiscaleEWMA, NormThreshold, PeakThreshold, Structured
from residua.decide.structured import CodeTest
from residua.monitor.running import Decisions
from residua.monitor.specification import Specification

ANSWERS = ("none", "exact", "several", "degraded", "nearest", "unknown")
KINDS = ("bank", "dedicated", "dedicated, at once", "with actuators", "groups", "groups, by direction", "alone",
         "means", "dedicated, means")  # fmt: skip


@cache
def bank_monitor(kind: str, outputs: int, window: int, seed: int) -> rs.Monitor:
    """Return a fitted monitor of a kind."""
    plant = sampled_plant(seed, outputs=outputs, states=3 + seed % 4, actuators=kind == "with actuators")
    test: Any = NormThreshold(window=window, persistence=1 + seed % 3, release=1 + seed % 4)
    if kind.startswith(("groups", "alone")):
        generator = rs.design.kalman_filter(plant)
        groups: Any = "each" if kind == "alone" else [list(generator.residuals[:1]), list(generator.residuals[1:])]
        window_of_names = None if seed % 2 else 5
        isolate: Any = Directional(window=window_of_names) if kind == "groups, by direction" else None
        test = replace(test, groups=groups)
    else:
        generator = hand_made_bank(plant, dedicated=kind.startswith("dedicated"))
        isolate = Structured(window=(1, 4, 30)[seed % 3], share=(0.5, 0.2, 1.0)[seed % 3], distance=seed % 3)
        if kind.endswith("means"):
            test = MultiscaleEWMA()
        if kind == "dedicated, at once":
            test = PeakThreshold(window=window)
    monitor = rs.Monitor(generator, test=test, isolate=isolate)
    return monitor.fit(*recording(plant, 3000, seed=99), false_alarm_rate=0.02, held_out=0.0)


def recorded(monitor: rs.Monitor, seed: int, samples: int) -> np.ndarray:
    """Return channels with faults of one sensor or more, gaps and values far off."""
    plant, rng = monitor.generator.plant, np.random.default_rng(seed)
    data = np.hstack(recording(plant, samples, seed=seed))
    for _ in range(6):
        start, length = rng.integers(samples), rng.integers(5, 80)
        which = rng.integers(len(plant.inputs), data.shape[1], rng.integers(1, 3))
        data[start : start + length, which] += 2 * rng.standard_normal(len(which))
    for mark in (np.nan, np.inf, 1e300, 1e12):
        data[rng.integers(samples), rng.integers(data.shape[1])] = mark
    gap = rng.integers(samples)
    data[gap : gap + 15, -1] = np.nan
    return data


def bank_expected(spec: Specification, decisions: Decisions) -> np.ndarray:
    """Return what C leaves of the decisions on the first plant: columns of ``expected``, then those of parts."""
    if not isinstance(spec.isolation, CodeTest):
        columns = [expected(spec, decisions)]
    else:
        usable = decisions.usable[0]
        known = ~np.isnan(decisions.residuals[0]).any(axis=1)
        scores = np.nan_to_num(decisions.named.scores[0])
        answers, best = np.zeros(len(usable)), np.zeros(len(usable))
        code = decisions.code[0]
        for k in np.flatnonzero(usable & code.any(axis=1)):
            reading = spec.isolation.read(code[k])
            answers[k] = ANSWERS.index(reading.answer)
            if reading.faults:
                best[k] = 1 + _group_of(spec.isolation, reading.faults, reading.settled, code[k])
        columns = [
            np.where(known[:, None], decisions.residuals[0], 0.0),
            np.where(usable, decisions.statistic[0], 0.0)[:, None],
            known[:, None],
            usable[:, None],
            decisions.alarm[0][:, None],
            best[:, None],
            scores,
            code,
            answers[:, None],
        ]
    parts = np.where(decisions.usable[0][:, None], decisions.member_statistics[0], 0.0)
    return np.hstack([*columns, parts, decisions.fired[0]])


def _group_of(codes: CodeTest, faults: tuple[str, ...], settled: tuple[str, ...], pattern: np.ndarray) -> int:
    """Return the nearest group with these faults of which the same have settled."""
    named = list(zip(codes.groups, codes.settled, strict=True))
    same = [g for g, one in enumerate(named) if one == (faults, settled)]
    off = [np.count_nonzero(codes.codes[:, g] != pattern) for g in same]
    return same[int(np.argmin(off))]
