"""How exported C is compared with the monitor itself: on which samples, how far it may be off, and by which program."""

from __future__ import annotations

from dataclasses import dataclass
from textwrap import wrap

import numpy as np
from numpy.typing import NDArray

from residua.errors import SettingError
from residua.export.monitor_program import MonitorProgram
from residua.export.writer import indented
from residua.monitor.running import initial_state, run_reference
from residua.monitor.specification import Specification

#: Samples of the comparison, and of a gap in the middle of it.
_SAMPLES, _GAP = 400, 5
#: Sizes that a signal has, in units of what moves the statistic to its threshold.
_SIZES = 3.0


#: Samples over which a filter forgets its start, at most, and what is left of it then.
_LONGEST, _LEFT = 1_000_000, 2.0**-10


@dataclass(frozen=True)
class Comparison:
    """Signals, and what the monitor says of them.

    Attributes
    ----------
    u, y : ndarray, shape (samples, channels)
    residuals : ndarray, shape (samples, residuals)
        Zeros where they are not known.
    statistic : ndarray
        Zeros where nothing is decided.
    known, decided, alarm : ndarray of bool
    bound : ndarray, shape (residuals,)
        By how much residuals may differ: zeros in double precision.
    """

    u: NDArray[np.float64]
    y: NDArray[np.float64]
    residuals: NDArray[np.float64]
    statistic: NDArray[np.float64]
    known: NDArray[np.bool_]
    decided: NDArray[np.bool_]
    alarm: NDArray[np.bool_]
    bound: NDArray[np.float64]


def comparison(made: MonitorProgram) -> Comparison:
    """Return noise with a few missing values, large enough for alarms, and what the monitor says of it."""
    spec, cut = made.specification, len(made.inputs)
    rng = np.random.default_rng(0)
    moved = rng.standard_normal((_SAMPLES, spec.B.shape[1])) * _size_of_signals(made)
    moved[_SAMPLES // 2 :] *= 2.0
    limited = np.clip(moved, spec.plausible[:, 0], spec.plausible[:, 1])
    if made.precision.name == "float":
        limited = limited.astype(np.float32).astype(float)
    data = limited + spec.offset
    if made.precision.name == "float":
        data = data.astype(np.float32).astype(float)
    sizes = np.abs(data - spec.offset).max(axis=0, initial=0.0)
    gap = slice(_SAMPLES // 2, _SAMPLES // 2 + _GAP)
    if data.shape[1]:
        data[gap, -1] = np.nan
    _, decisions = run_reference(spec, initial_state(spec, 1), data[None])
    tested, residuals = decisions.tested, decisions.residuals[0]
    known = ~np.isnan(residuals).any(axis=1)
    single = made.precision.name == "float"
    return Comparison(
        data[:, :cut],
        data[:, cut:],
        np.where(known[:, None], residuals, 0.0),
        np.where(tested.usable[0], tested.statistic[0], 0.0),
        known,
        tested.usable[0],
        tested.alarm[0],
        rounding_bound(spec, sizes) if single else np.zeros(len(spec.C)),
    )


def _size_of_signals(made: MonitorProgram) -> NDArray[np.float64]:
    """Return deviations of the channels that move the residual to its threshold, about."""
    spec = made.specification
    test = spec.test.compiled
    assert test is not None
    moved = np.abs(spec.D) + np.abs(spec.C @ spec.start)
    white = np.abs(test.whitening.T) @ moved
    size = np.linalg.norm(white, axis=0)
    return _SIZES * test.threshold / np.where(size > 0, size, 1.0) / np.sqrt(max(1, spec.B.shape[1]))


def rounding_bound(spec: Specification, sizes: NDArray[np.float64]) -> NDArray[np.float64]:
    r"""Return by how much each residual may be off in single precision, while signals stay within their sizes.

    .. math::

       |\Delta r| \le |C| \sum_{k \ge 0} |A^k|\, \delta + \gamma (|C| X + |D| V), \qquad
       \delta = \gamma (|A| X + |B| V), \qquad X = \sum_{k \ge 0} |A^k B|\, V

    with :math:`\gamma = (n + m + 3) u` for sums of n + m products of rounded matrices and signals, u = 2^-24, and X
    enlarged by what rounding itself adds to the state.

    Parameters
    ----------
    spec : Specification
    sizes : ndarray, shape (channels,)
        Largest deviation of each channel from the operating point.

    Raises
    ------
    SettingError
        If the filter forgets so slowly, or the order is so high, that rounding is not bounded.
    """
    A, B, C, D = (np.abs(M) for M in (spec.A, spec.B, spec.C, spec.D))
    n, m = spec.B.shape
    unit = (n + m + 3) * 2.0**-24
    if not n:
        return unit * (D @ sizes)
    total, reached, power = np.zeros((n, n)), np.zeros(n), np.eye(n)
    for _ in range(_LONGEST):
        total += np.abs(power)
        reached += np.abs(power @ spec.B) @ sizes
        power = power @ spec.A
        if np.abs(power).sum() <= _LEFT * min(1.0, 1.0 / n):
            break
    else:
        raise SettingError("this filter forgets too slowly for single precision: export it in double precision")
    rest = 1 / (1 - _LEFT)  # the sums beyond are below that part of what came before
    total, reached = rest * total, rest * reached
    # the state is larger by what rounding adds to it: X' = X + T (unit (A X' + B V))
    growth = unit * np.linalg.norm(total @ A, np.inf)
    if growth >= 0.5:
        raise SettingError("rounding would grow in single precision without a bound: export it in double precision")
    reached = np.linalg.solve(np.eye(n) - unit * (total @ A), reached + unit * (total @ (B @ sizes)))
    each = unit * (A @ reached + B @ sizes)
    return C @ (total @ each) + unit * (C @ reached + D @ sizes)


def of_rounding(made: MonitorProgram, one: Comparison) -> tuple[str, ...]:
    """Return what a comparison says of single precision, in words."""
    if made.precision.name == "double":
        return ()
    sizes = np.abs(np.hstack([one.u, one.y]) - made.specification.offset)
    most = np.nanmax(sizes, axis=0, initial=0.0)
    channels = (*made.inputs, *made.outputs)
    within = ", ".join(f"{name} {size:.3g}" for name, size in zip(channels, most, strict=True))
    bounds = ", ".join(f"{bound:.2g}" for bound in one.bound)
    return (
        f"In single precision the residuals are off by at most {bounds}, while deviations from the operating point are "
        f"at most: {within}. Decisions near a threshold may differ.",
    )


def selftest(made: MonitorProgram, prefix: str, one: Comparison) -> str:
    """Return the program in C."""
    real = made.precision.name
    arrays = [
        *_array("u", one.u, real),
        *_array("y", one.y, real),
        *_array("residuals", one.residuals, "double"),
        *_array("statistic", one.statistic, "double"),
        *_array("bound", one.bound, "double"),
        *_array("flags", one.known + 2.0 * one.decided + 4.0 * one.alarm, "int"),
    ]
    exact = real == "double"
    same = [
        "if (decision.statistic != statistic[k]) {",
        "    wrong++;",
        "}",
        "if ((decision.known ? 1 : 0) + (decision.decided ? 2 : 0) + (decision.alarm ? 4 : 0) != flags[k]) {",
        "    wrong++;",
        "}",
    ]
    known = ["if ((decision.known ? 1 : 0) != flags[k] % 2) {", "    wrong++;", "}", "(void)statistic;"]
    width, residuals = (one.u.shape[1], one.y.shape[1]), one.residuals.shape[1]
    lines = [
        f"/* Runs {prefix}.c on {len(one.y)} samples, and compares it with the answers of the monitor in Python. */",
        f'#include "{prefix}.h"',
        "#include <math.h>",
        "#include <stdio.h>",
        "",
        *arrays,
        "",
        "int main(void)",
        "{",
        f"    {prefix}_state state;",
        f"    {prefix}_decision decision;",
        "    int wrong = 0;",
        "    int j;",
        "    int k;",
        f"    {prefix}_init(&state);",
        f"    for (k = 0; k < {len(one.y)}; k++) {{",
        f"        {prefix}_step(&state, &u[k * {width[0]}], &y[k * {width[1]}], &decision);",
        f"        for (j = 0; j < {residuals}; j++) {{",
        f"            if (!(fabs((double)decision.residual[j] - residuals[k * {residuals} + j]) <= bound[j])) {{",
        "                wrong++;",
        "            }",
        "        }",
        *indented(indented(same if exact else known)),
        "    }",
        f'    printf("%s: {len(one.y)} samples, %d differences\\n", wrong ? "FAILED" : "passed", wrong);',
        "    return wrong ? 1 : 0;",
        "}",
    ]
    return "\n".join(lines) + "\n"


def _array(name: str, values: NDArray[np.float64], kind: str) -> list[str]:
    """Return the definition of an array; hexadecimal numbers are exact, and a missing value overflows nothing."""
    flat = np.asarray(values, dtype=float).ravel()
    suffix = "f" if kind == "float" else ""
    if kind == "int":
        text = [str(int(value)) for value in flat]
    else:
        text = [f"{value.hex()}{suffix}" if np.isfinite(value) else "NAN" for value in map(float, flat)]
    lines = indented(wrap(", ".join(text or ["0"]), 100))
    return [f"static const {kind} {name}[{max(1, len(flat))}] = {{", *lines, "};"]


__all__ = ["Comparison", "comparison", "of_rounding", "rounding_bound", "selftest"]
