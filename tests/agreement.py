"""Every public answer about which faults can be seen, against one exact oracle: what disagrees."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

import residua as rs
from exact_answers import Exact, pairs_apart
from residua.errors import AccuracyError, DesignError


@dataclass
class Disagreements:
    """What was asked, counted, and where an answer is not the exact one."""

    counts: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)

    def same(self, told: str, question: str, answer: object, exact: object) -> None:
        """Count a question, and note it when the answer is not the exact one."""
        self.counts[question] += 1
        if not np.array_equal(np.asarray(answer), np.asarray(exact)):
            self.wrong.append(f"{told}: {question}: {_short(answer)}, exactly {_short(exact)}")


def _short(x: object) -> str:
    return str(np.asarray(x).astype(int).tolist()) if isinstance(x, np.ndarray) else str(x)


def compare(plant: rs.Plant, exact: Exact, told: str, out: Disagreements, seed: int) -> None:
    """Ask all there is to ask about the faults of a plant."""
    _about_pairs(plant, exact, told, out)
    rng = np.random.default_rng([33, seed])
    n = len(plant.faults)
    for size in (0, 1, int(rng.integers(0, n))):
        ignored = sorted(rng.permutation(n)[: min(size, n - 1)].tolist())
        _about_one_set(plant, exact, ignored, f"{told}, ignores {ignored}", out)
    _about_orders(plant, exact, told, out)


def _about_pairs(plant: rs.Plant, exact: Exact, told: str, out: Disagreements) -> None:
    found = rs.diagnosability(plant)
    n = len(plant.faults)
    seen = exact.visible()
    isolable = np.array([exact.visible([j]) for j in range(n)]).T & ~np.eye(n, dtype=bool)
    traces = exact.traces()
    out.same(told, "detectable", found.detectable, seen)
    out.same(told, "isolable", found.isolable, isolable)
    out.same(told, "strongly detectable", found.strongly_detectable, traces.any(axis=0))
    out.same(told, "strongly isolable", found.strongly_isolable, pairs_apart(traces) & isolable)
    out.same(told, "mutually isolable", rs.coding.mutually_isolable(plant).matrix, isolable & isolable.T)


def _about_one_set(plant: rs.Plant, exact: Exact, ignored: list[int], told: str, out: Disagreements) -> None:
    """Ask about residuals that ignore a set: which row is attainable, and who reaches it."""
    names = [plant.faults[i] for i in ignored]
    seen, lasting = exact.visible(ignored), exact.lasting(ignored)
    for row in {tuple(seen), tuple(i not in ignored for i in range(len(plant.faults)))}:
        if not any(row):
            continue
        zeros = [i for i, one in enumerate(row) if not one]
        code = "".join("01"[int(one)] for one in row)
        sees = exact.visible(zeros)
        fine = bool(sees[list(np.flatnonzero(row))].all())
        out.same(f"{told}, row {code}", "attainable", bool(rs.coding.attainable(plant, [code])), fine)
        for_good = fine and bool(exact.lasting(zeros)[list(np.flatnonzero(row))].all())
        constant = bool(rs.coding.attainable(plant, [code], constant=True))
        out.same(f"{told}, row {code}", "attainable, constant", constant, for_good)
        _about_parity(plant, exact, code, fine, told, out)
    exists = exact.exists(ignored)
    try:
        made = rs.design.decoupled_residual(plant, insensitive_to=names)
    except AccuracyError as error:
        out.counts["decoupled residual: refused for accuracy"] += 1
        out.refused.append(f"{told}: decoupled residual: {error}")
        return
    except DesignError:
        out.same(told, "decoupled residual exists", False, exists)
        return
    out.same(told, "decoupled residual exists", True, exists)
    out.same(told, "decoupled residual answers to", made.structure.any(axis=0), seen)
    settles = np.array([bool(np.any(made.steady_directions.get(name, 0))) for name in plant.faults])
    out.same(told, "decoupled residual answers for good to", settles, lasting)


def _about_parity(plant: rs.Plant, exact: Exact, code: str, fine: bool, told: str, out: Disagreements) -> None:
    told = f"{told}, row {code}"
    zeros = [i for i, c in enumerate(code) if c == "0"]
    ones = [i for i, c in enumerate(code) if c == "1"]
    try:
        bank = rs.design.structured_parity(plant, [code])
    except AccuracyError as error:
        out.counts["structured parity: refused for accuracy"] += 1
        out.refused.append(f"{told}: structured parity: {error}")
        return
    except DesignError as error:
        out.same(told, "structured parity exists", False, fine)
        if fine:
            out.wrong[-1] += f" ({error})"
        return
    out.same(told, "structured parity exists", True, fine)
    if fine:
        assert bank.generator.relations is not None
        out.same(told, "order of a structured relation", bank.generator.relations.orders[0], exact.order(zeros, ones))
        out.same(
            told, "structured parity has the code", "".join("01"[int(x)] for x in bank.generator.structure[0]), code
        )


def _about_orders(plant: rs.Plant, exact: Exact, told: str, out: Disagreements) -> None:
    """Ask for the shortest relations that read some outputs."""
    found = rs.design.parity_orders(plant, most_outputs=2)
    wanted = {}
    for chosen in rs_sets(plant.n_outputs):
        order = exact.order([], [], [i for i in range(plant.n_outputs) if i not in chosen])
        if order is not None:
            wanted[tuple(plant.outputs[i] for i in chosen)] = order
    out.same(told, "orders of parity relations", str(found), str(wanted))


def rs_sets(count: int) -> list[tuple[int, ...]]:
    """Return the sets of one and of two outputs."""
    return [(i,) for i in range(count)] + [(i, j) for i in range(count) for j in range(i + 1, count)]
