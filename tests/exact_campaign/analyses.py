"""The public analyses against the exact answers."""

from __future__ import annotations

import numpy as np
from flint import fmpq, fmpq_poly

import residua as rs
from exact import questions
from exact.matrices import rank, rational
from exact.plants import at
from exact.stability import distance_to_boundary, roots
from exact_campaign.answers import Record, Subject, plain

#: Zeros are right when the polynomial that they are the roots of is, relative to the one with all signs equal.
_ZEROS_TOLERANCE = 1e-6
#: A root that is nearer to the boundary than this, relative to its size, and not on it, is close.
_BOUNDARY = 1e-7


def analyses(subject: Subject) -> None:
    """Ask every analysis."""
    for which in ("u", "d", "f", "none"):
        _zeros(subject, which)
    _ranks_at_points(subject)
    _detectability(subject)
    _existence(subject)
    _diagnosability(subject)
    _mutual(subject)
    _attainable(subject, constant=False)
    _attainable(subject, constant=True)


def near_boundary(p: fmpq_poly, sampled: bool) -> bool:
    """Tell whether a stability decision is close."""
    return distance_to_boundary(p, sampled) < _BOUNDARY


def zeros_missed(found: np.ndarray, exact: fmpq_poly, rates: float) -> float:
    """Return how far the polynomial of the zeros is from the exact one, relative to the one without signs."""
    wanted = [z for z, k in roots(exact) for _ in range(k)]
    size = max([abs(z) for z in wanted], default=0.0)
    a, b = np.poly(found) if len(found) else np.ones(1), np.poly(wanted) if wanted else np.ones(1)
    scale = np.poly([-(abs(z) + 1e-3 * max(size, 1e-3 * rates)) for z in wanted]) if wanted else np.ones(1)
    return float(np.max(np.abs(a - b) / scale))


def _zeros(subject: Subject, which: str) -> None:
    plant, X = subject.plant, subject.exact
    B, D = {
        "u": (plant.B, plant.D),
        "d": (plant.Bd, plant.Dd),
        "f": (np.hstack([plant.Bd, plant.Bf]), np.hstack([plant.Dd, plant.Df])),
        "none": (plant.B[:, :0], plant.D[:, :0]),
    }[which]
    record = subject.ask(
        f"invariant_zeros ({which})", lambda: rs.linear.invariant_zeros(plant.A, B, plant.C, D, plant.E)
    )
    exact, rank_there = questions.zeros_from(X, which)
    wanted = rank_there - X.n
    if record.answer.refused:
        record.problem("wrong", "zeros", f"refused: {record.answer.refused[:120]}; exact: {exact}")
        return
    if record.answer.made is None:
        return
    found = record.answer.made
    record.facts = {"count": len(found.zeros), "normal rank": found.normal_rank}
    if found.normal_rank != wanted:
        record.problem("wrong", "zeros", f"normal rank {found.normal_rank}, exact {wanted}")
    if len(found.zeros) != exact.degree():
        record.problem("wrong", "zeros", f"zeros {found.zeros}, exact polynomial {exact}")
        return
    missed = zeros_missed(found.zeros / subject.by.t, exact, subject.rates)
    if missed > _ZEROS_TOLERANCE:
        record.problem("wrong", "zeros", f"zeros {found.zeros} miss {exact} by {missed:.1e}")


def _ranks_at_points(subject: Subject) -> None:
    """Compare the rank of the pencil at a few rational points, zeros among them, with the exact one."""
    plant, X = subject.plant, subject.exact
    P = X.pencil(X.Bd, X.Dd)
    p = questions.fixed_polynomial(X)
    places = [rational(z.real) for z, _ in roots(p) if z.imag == 0 and p(rational(z.real)) == 0][:2]
    points = [(str(s), s) for s in (fmpq(0), fmpq(3, 8))] + [(f"{i}: a zero", s) for i, s in enumerate(places)]
    for name, s in points:  # each under a name of its own, by which its answer is kept
        value = subject.by.t * float(s.p) / float(s.q)
        record = subject.ask(
            f"pencil_rank_at ({name})",
            lambda value=value: rs.linear.pencil_rank_at(plant.A, plant.Bd, plant.C, plant.Dd, plant.E, value),
            about=str(s),  # the zeros of the floats may come in another order than those of the case
        )
        if record.answer.made is not None:
            wanted = rank(at(P, s))
            record.facts = {"rank": record.answer.made.rank}
            if record.answer.made.rank != wanted:
                record.problem("wrong", "ranks", f"rank {record.answer.made} at {s}, exact {wanted}")


def _detectability(subject: Subject) -> None:
    plant, X = subject.plant, subject.exact
    if not X.plain:
        return
    record = subject.ask("detectability", lambda: rs.linear.detectability(plant.A, plant.C, dt=plant.dt))
    if record.answer.refused:
        record.problem("wrong", "detectability", f"refused: {record.answer.refused[:200]}")
    if record.answer.made is None:
        return
    found, p = record.answer.made, questions.hidden_polynomial(X)
    record.facts = {"detectable": bool(found), "hidden": len(found.unobservable_modes)}
    wanted = questions.detectable(X)
    if bool(found) != wanted:
        close = near_boundary(p, X.sampled)
        text = f"detectable={bool(found)}, exact {wanted}, hidden modes {_texts(p)}"
        record.problem("close" if close else "wrong", "detectability", text)
    if len(found.unobservable_modes) != p.degree():
        record.problem("wrong", "detectability", f"hidden modes {found.unobservable_modes}, exact {_texts(p)}")


def _existence(subject: Subject) -> None:
    plant, X = subject.plant, subject.exact
    record = subject.ask(
        "unknown_input_observer_existence", lambda: rs.analysis.unknown_input_observer_existence(plant)
    )
    proper, stable = questions.unknown_input_observer(X)
    if record.answer.refused:
        record.problem("wrong", "existence", f"the analysis refuses: {record.answer.refused[:200]}")
        return
    if record.answer.made is None:
        return
    found = record.answer.made
    P = questions.fixed_polynomial(X)
    record.facts = {
        "exists": bool(found.exists),
        "reasons": len(found.reasons),
        "fixed": len(found.fixed_poles),
        "useful": bool(found.useful),
    }
    if found.exists != (proper and stable):
        text = f"exists={found.exists}, exact: (i) {proper}, (ii) {stable}, zeros {_texts(P)}; {found.reasons}"
        close = proper and near_boundary(P, X.sampled)
        record.problem("close" if close else "wrong", "existence", text)
    elif not found.exists and ("rank" in found.reasons[0].split(":")[0]) == proper:
        record.problem("wrong", "existence", f"the wrong reason: {found.reasons}; exact: (i) {proper}, (ii) {stable}")
    if (proper and found.exists and len(found.fixed_poles) != P.degree()) or (
        proper and found.exists and zeros_missed(found.fixed_poles / subject.by.t, P, subject.rates) > _ZEROS_TOLERANCE
    ):
        record.problem("wrong", "existence", f"fixed poles {found.fixed_poles}, exact zeros {_texts(P)}")
    if found.exists and found.useful != questions.residual_exists(X):
        record.problem("wrong", "existence", f"useful={found.useful}, exact {not found.useful}")


def _texts(p: fmpq_poly) -> str:
    return ", ".join(f"{z:.6g}" + (f" ({k}x)" if k > 1 else "") for z, k in roots(p)) or "none"


def _diagnosability(subject: Subject) -> None:
    record = subject.ask("diagnosability", lambda: rs.diagnosability(subject.plant))
    if record.answer.refused:
        record.problem("wrong", "diagnosability", f"refused: {record.answer.refused[:200]}")
    if record.answer.made is None:
        return
    X, found = subject.exact, record.answer.made
    record.facts = {
        "detectable": plain(found.detectable),
        "strong": plain(found.strongly_detectable),
        "isolable": plain(found.isolable),
        "strongly isolable": plain(found.strongly_isolable),
        "groups": plain(found.groups),
        "reasons": found.reasons(),
    }
    exact = {
        "detectable": questions.visible(X),
        "isolable": questions.isolable(X),
        "strong": questions.lasting(X),
        "strongly isolable": questions.lasting_isolable(X),
    }
    for name, wanted in exact.items():
        if record.facts[name] != wanted:
            topic = "diagnosability" if name in ("detectable", "isolable") else "constant faults"
            record.problem("wrong", topic, f"{name} {_bits(record.facts[name])}, exact {_bits(wanted)}")
    groups = _grouped(subject.plant.faults, exact["detectable"], exact["isolable"])
    if record.facts["groups"] != groups and record.facts["isolable"] == exact["isolable"]:
        record.problem("wrong", "diagnosability", f"groups {record.facts['groups']}, exact {groups}")


def _grouped(names: tuple[str, ...], seen: list[bool], apart: list[list[bool]]) -> list[list[str]]:
    groups: list[list[int]] = []
    for i in (i for i, one in enumerate(seen) if one):
        for group in groups:
            if not apart[group[0]][i] and not apart[i][group[0]]:
                group.append(i)
                break
        else:
            groups.append([i])
    return [[names[i] for i in group] for group in groups]


def _bits(value: list) -> str:
    if value and isinstance(value[0], list):
        return "/".join(_bits(row) for row in value)
    return "".join("01"[bool(x)] for x in value)


def _mutual(subject: Subject) -> None:
    record = subject.ask("mutually_isolable", lambda: rs.coding.mutually_isolable(subject.plant))
    if record.answer.refused:
        record.problem("wrong", "diagnosability", f"refused: {record.answer.refused[:200]}")
    if record.answer.made is None:
        return
    found, one = record.answer.made, questions.isolable(subject.exact)
    k = len(one)
    wanted = [[one[i][j] and one[j][i] for j in range(k)] for i in range(k)]
    record.facts = {"matrix": plain(found.matrix), "groups": plain(found.groups), "reasons": found.reasons}
    if record.facts["matrix"] != wanted:
        text = f"mutually_isolable {_bits(record.facts['matrix'])}, exact {_bits(wanted)}"
        record.problem("wrong", "diagnosability", text)


def _attainable(subject: Subject, *, constant: bool) -> None:
    plant, X = subject.plant, subject.exact
    k = len(plant.faults)
    rows = [[bool(code >> i & 1) for i in range(k)] for code in range(1, 2**k)]
    name = "attainable (constant)" if constant else "attainable"
    texts = ["".join("01"[x] for x in row) for row in rows]
    record = subject.ask(name, lambda: rs.coding.attainable(plant, texts, constant=constant))
    listed = subject.ask(f"{name}, all", lambda: rs.coding.attainable(plant, constant=constant))
    for one in (record, listed):
        if one.answer.refused:
            one.problem("wrong", "attainable", f"refused: {one.answer.refused[:200]}")
    if record.answer.made is None:
        return
    wanted = [questions.attainable(X, row, constant=constant) for row in rows]
    found = plain(record.answer.made.attainable)
    record.facts = {"rows": found, "reasons": record.answer.made.reasons, "independent": record.answer.made.independent}
    _compare_rows(record, texts, found, wanted)
    independent = X.n + X.p - questions.generic_rank(X)
    if record.answer.made.independent > independent:
        record.problem("wrong", "attainable", f"{record.answer.made.independent} independent, exact {independent}")
    if listed.answer.made is not None:
        digits = set(listed.answer.made.digits)
        listed.facts = {"rows": sorted(digits)}
        _compare_rows(listed, texts, [text in digits for text in texts], wanted)


def _compare_rows(record: Record, texts: list[str], found: list[bool], wanted: list[bool]) -> None:
    for text, a, b in zip(texts, found, wanted, strict=True):
        if a != b:
            record.problem("wrong", "attainable", f"{record.function}: row {text} {a}, exact {b}")
            return
