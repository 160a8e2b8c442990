"""Comparison of exported C with the monitor itself: the samples, the tolerance, and the program."""

from __future__ import annotations

from dataclasses import dataclass
from textwrap import wrap

import numpy as np
from numpy.typing import NDArray

from residua.errors import SettingError
from residua.export.monitor_program import MonitorProgram
from residua.export.writer import indented
from residua.linear.poles.spectrum import spectral_radius
from residua.monitor.running import initial_state, run_reference
from residua.monitor.specification import Specification

#: Samples of the comparison, and of a gap in the middle of it.
_SAMPLES, _GAP = 400, 5
#: Sizes of a signal, in units that move the statistic to its threshold.
_SIZES = 3.0


#: Largest number of samples in which a filter forgets its start, and the remainder then.
_LONGEST, _LEFT = 100_000, 2.0**-10
#: Rounding of a number in single precision, and in double precision.
_UNIT, DOUBLE_UNIT = 2.0**-24, 2.0**-53


@dataclass(frozen=True)
class Comparison:
    """Signals, and the monitor's answers on them.

    Attributes
    ----------
    u, y : ndarray, shape (samples, channels)
    residuals : ndarray, shape (samples, residuals)
        Zeros where they are not known.
    statistic : ndarray
        Zeros where nothing is decided.
    known, decided, alarm : ndarray of bool
    bound : ndarray, shape (residuals,)
        By how much residuals may differ where something is decided: zeros in double precision, and everywhere.
    fired : ndarray of bool, shape (samples, parts)
        Which parts are in alarm, where some are tested by themselves.
    """

    u: NDArray[np.float64]
    y: NDArray[np.float64]
    residuals: NDArray[np.float64]
    statistic: NDArray[np.float64]
    known: NDArray[np.bool_]
    decided: NDArray[np.bool_]
    alarm: NDArray[np.bool_]
    bound: NDArray[np.float64]
    fired: NDArray[np.bool_]


def comparison(made: MonitorProgram) -> Comparison:
    """Return noise with a few missing values, large enough for alarms, and the monitor's answers on it."""
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
        tested.fired[0],
    )


def _size_of_signals(made: MonitorProgram) -> NDArray[np.float64]:
    """Return deviations of the channels that move the residual to about its threshold."""
    spec = made.specification
    moved = np.abs(spec.D) + np.abs(spec.C @ spec.start)
    size = np.linalg.norm(np.abs(made.judging.per_threshold.T) @ moved, axis=0)
    return _SIZES / np.where(size > 0, size, 1.0) / np.sqrt(max(1, spec.B.shape[1]))


def rounding_bound(spec: Specification, sizes: NDArray[np.float64], rounding: float = _UNIT) -> NDArray[np.float64]:
    r"""Return a bound on the rounding error of each residual, after the filter has settled.

    .. math::

       |\Delta r| \le H \delta + (G_r + |D|) v + \gamma (|C| X + |D| V) + H |A^s| e_0, \qquad
       \delta = \gamma (|A| X + |B| V)

    with :math:`H = \sum_{k \ge 0} |C A^k|`, :math:`G_r = \sum_{k \ge 0} |C A^k B|`, :math:`\gamma = (n + m + 3) u` for
    sums of n + m products of rounded matrices and signals, u the rounding of a number, states of
    :math:`X = \sum |A^k B| V` enlarged by what rounding adds to them, :math:`v = u (V + |\text{offset}|)` for the
    difference from the operating point, and what the start of the filter is off by, :math:`e_0`, of which :math:`A^s`
    is left when it has settled.

    Parameters
    ----------
    spec : Specification
    sizes : ndarray, shape (channels,)
        V, the largest deviation of each channel from the operating point.
    rounding : float
        u: 2^-24 for single precision, 2^-53 for double precision.

    Raises
    ------
    SettingError
        If the filter forgets so slowly, or amplifies so much, that this bounds nothing.
    """
    A, B, C, D = (np.abs(M) for M in (spec.A, spec.B, spec.C, spec.D))
    n, m = spec.B.shape
    unit = (n + m + 3) * rounding
    taken = rounding * (sizes + np.abs(spec.offset))
    if not n:
        return unit * (D @ sizes) + D @ taken
    (states, gains), (H, on_residual) = (_sums_of_powers(spec.A, spec.B, M) for M in (np.eye(n), spec.C))
    if spectral_radius(unit * (states @ A)) >= 0.5:
        raise SettingError(
            "this filter amplifies rounding so much that nothing can be promised in single precision: export it in "
            "double precision"
        )
    reached = np.linalg.solve(np.eye(n) - unit * (states @ A), gains @ sizes + unit * (states @ (B @ sizes)))
    residuals = C @ reached + D @ sizes
    steady = H @ (unit * (A @ reached + B @ sizes)) + (on_residual + D) @ taken + unit * residuals
    start = np.abs(spec.start) @ (unit * sizes + taken)
    begun, first = 0, spec.first
    if first is not None:  # its residuals correct the start, with their own errors
        begun, rows = first.samples, np.abs(first.rows).reshape(-1, len(spec.C), n).sum(axis=0)
        off = steady + H @ start + (first.samples + len(spec.C)) * rounding * residuals
        start = states @ start + np.abs(first.correction) @ (np.sum(off[:, None] * rows, axis=0))
        start += n * rounding * (np.abs(first.correction) @ (residuals @ rows))
    left = np.abs(np.linalg.matrix_power(spec.A, max(spec.settle - begun, 0)))
    return steady + H @ (left @ start)


def _sums_of_powers(
    A: NDArray[np.float64], B: NDArray[np.float64], C: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return upper bounds on the sums of the sizes of C A^k and of C A^k B."""
    n = len(A)
    total, gains, power = np.zeros(C.shape), np.zeros((len(C), B.shape[1])), np.eye(n)
    for _ in range(_LONGEST):
        now = C @ power
        total += np.abs(now)
        gains += np.abs(now @ B)
        power = power @ A
        if np.abs(power).sum() <= _LEFT / n:  # bound on the remainder: H <= H_N + H |A^N|, and the part of B
            every = np.asarray(np.linalg.solve(np.eye(n) - np.abs(power).T, total.T).T, dtype=float)
            return every, gains + (every @ np.abs(power)) @ np.abs(B)
    raise SettingError("this filter forgets too slowly for single precision: export it in double precision")


def of_rounding(made: MonitorProgram, one: Comparison) -> tuple[str, ...]:
    """Describe a comparison in single precision."""
    if made.precision.name == "double":
        return ()
    sizes = np.abs(np.hstack([one.u, one.y]) - made.specification.offset)
    most = np.nanmax(sizes, axis=0, initial=0.0)
    channels = (*made.inputs, *made.outputs)
    within = ", ".join(f"{name} {size:.3g}" for name, size in zip(channels, most, strict=True))
    bounds = ", ".join(f"{bound:.2g}" for bound in one.bound)
    return (
        f"In single precision, where something is decided, the residuals are off by at most {bounds}, while deviations "
        "from the operating point are "
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
    exact, parts = real == "double", one.fired.shape[1]
    if exact and parts:
        arrays += _array("fired", one.fired.astype(float), "int")
    compared = _compared(parts) if exact else _known()
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
        f"            const double off = fabs((double)decision.residual[j] - residuals[k * {residuals} + j]);",
        f"            if ({'' if exact else 'decision.decided && '}!(off <= bound[j])) {{",
        "                wrong++;",
        "            }",
        "        }",
        *indented(indented(compared)),
        "    }",
        f'    printf("%s: {len(one.y)} samples, %d differences\\n", wrong ? "FAILED" : "passed", wrong);',
        "    return wrong ? 1 : 0;",
        "}",
    ]
    return "\n".join(lines) + "\n"


def _compared(parts: int) -> list[str]:
    """Return the lines that compare a decision with that of the monitor."""
    lines = [
        "if (decision.statistic != statistic[k]) {",
        "    wrong++;",
        "}",
        "if ((decision.known ? 1 : 0) + (decision.decided ? 2 : 0) + (decision.alarm ? 4 : 0) != flags[k]) {",
        "    wrong++;",
        "}",
    ]
    if parts:
        lines += [
            f"for (j = 0; j < {parts}; j++) {{",
            f"    if ((decision.fired[j] ? 1 : 0) != fired[k * {parts} + j]) {{",
            "        wrong++;",
            "    }",
            "}",
        ]
    return lines


def _known() -> list[str]:
    """Return the lines that compare values independent of rounding."""
    return ["if ((decision.known ? 1 : 0) != flags[k] % 2) {", "    wrong++;", "}", "(void)statistic;"]


def _array(name: str, values: NDArray[np.float64], kind: str) -> list[str]:
    """Return the definition of an array; hexadecimal numbers are exact, and a missing value causes no overflow."""
    flat = np.asarray(values, dtype=float).ravel()
    suffix = "f" if kind == "float" else ""
    if kind == "int":
        text = [str(int(value)) for value in flat]
    else:
        text = [f"{value.hex()}{suffix}" if np.isfinite(value) else "NAN" for value in map(float, flat)]
    lines = indented(wrap(", ".join(text or ["0"]), 100))
    return [f"static const {kind} {name}[{max(1, len(flat))}] = {{", *lines, "};"]


__all__ = ["DOUBLE_UNIT", "Comparison", "comparison", "of_rounding", "rounding_bound", "selftest"]
