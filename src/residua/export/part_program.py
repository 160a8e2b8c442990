"""The part of a program where members of a bank, or groups of residuals, are tested separately."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from residua.decide.structured import CodeTest
from residua.export import part_texts as texts
from residua.export.judging import Judging
from residua.export.program import Kind, Variable
from residua.export.step_texts import FORETELL


def part_sizes(judging: Judging) -> dict[str, int]:
    """Return the values of the names in capitals in the texts."""
    parts, codes = judging.parts, judging.codes
    if parts is None:
        return {}
    return {
        "PARTS": len(parts.sizes),
        "OVERALL": 0 if parts.whole is None else parts.whole.shape[1],
        "CODE_WINDOW": 1 if codes is None else codes.window,
        "AT_ONCE": int(codes is not None and codes.at_once and codes.dedicated),
        "DEDICATED": int(codes is not None and codes.dedicated),
        "STRONG": int(codes is not None and codes.strongly_isolating),
        "DISTANCE": 0 if codes is None else codes.distance,
    }


def part_sections(judging: Judging) -> list[tuple[str, str]]:
    """Return the texts with their titles, in order."""
    if judging.test.statistic == "means":
        made = [
            ("its innovations by the autoregression", FORETELL),
            ("the longest mean of each part", texts.MEANS),
            ("the alarms", texts.MEAN_ALARMS),
        ]
    else:
        made = [("the norm of each part", texts.NORMS), ("the alarms", texts.ALARMS)]
    if judging.naming.bases:
        made += [
            ("all residuals in units in which their direction is judged", texts.OVERALL),
            (
                "the mean of the residual that is compared",
                texts.AVERAGE_OVERALL if judging.naming.window else texts.CLEAR_MEAN_OVERALL,
            ),
            ("how well each group of faults explains the residual", texts.NAME_OVERALL),
        ]
    if judging.codes is not None:
        made += [("which members count as fired", texts.CODE), ("the reading of the code", texts.READ)]
    return made


def part_variables(judging: Judging, size: dict[str, int]) -> list[Variable]:
    """Return the variables that only these texts have."""
    parts, codes = judging.parts, judging.codes
    if parts is None:
        return []
    count = len(parts.sizes)
    column = np.repeat(np.arange(count), parts.sizes)

    def output(name: str, kind: Kind, length: int | None, words: str) -> Variable:
        return Variable(name, kind, "output", length, (), words)

    made = [
        _constant("part_of_column", "count", column),
        _constant("part_threshold", "real", parts.thresholds),
        _constant("part_release", "real", judging.test.lengths[2] if judging.test.lengths else ()),
        output("part_statistic", "real", count, "of each part; zeros where nothing is decided"),
        output("fired", "flag", count, "which parts are in alarm"),
        Variable("part_above", "count", "state", count, (), "samples in a row over the threshold of a part"),
        Variable("part_below", "count", "state", count, (), "samples in a row that are not"),
        Variable("part_standing", "flag", "state", count, (), "whether a part is in alarm"),
    ]
    if parts.whole is not None:
        made += [_constant("whole", "real", parts.whole), Variable("overall", "real", "local", size["OVERALL"])]
    if codes is not None:
        words = "0 none, 1 exact, 2 several, 3 degraded, 4 nearest, 5 unknown"
        made += [
            output("code", "flag", count, "which parts count as fired over the window"),
            output("answer", "count", None, words),
            *_of_codes(codes),
            Variable("code_values", "real", "state", codes.window * count, (), "of the moving sum of the code"),
            Variable("code_begun", "real", "state", count),
            Variable("code_filled", "count", "state"),
            Variable("flagged", "real", "local", count),
            Variable("counted", "real", "local", count),
            Variable("distance_to", "count", "local", len(codes.groups)),
            Variable("covering", "flag", "local", len(codes.groups)),
            *(Variable(name, "count", "local") for name in ("smallest_distance", "nearest", "leader")),
            *(Variable(name, "flag", "local") for name in ("covers", "whole_code", "owned", "lone")),
        ]
    return made


def _of_codes(codes: CodeTest) -> list[Variable]:
    """Return the codes of the faults, and the groups that contain the same faults or some of them."""
    classes = {group: k + 1 for k, group in enumerate(dict.fromkeys(codes.groups))}
    contained = [[set(other) <= set(one) for other in codes.groups] for one in codes.groups]
    return [
        _constant("code_table", "count", codes.codes),
        _constant("part_owned", "count", [bool(row.any()) for row in codes.codes]),
        _constant("class_of_group", "count", [classes[group] for group in codes.groups]),
        _constant("contained", "count", contained),
        Variable("share", "real", "constant", None, (codes.share,)),
        Variable("number_of_parts", "real", "constant", None, (float(len(codes.members)),)),
    ]


def _constant(name: str, kind: Kind, values: Sequence[Any] | np.ndarray) -> Variable:
    flat = np.asarray(values, dtype=float).ravel()
    return Variable(name, kind, "constant", len(flat), tuple(flat.tolist()))


__all__ = ["part_sections", "part_sizes", "part_variables"]
