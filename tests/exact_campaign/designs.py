"""Every design against what exists exactly, and what it returns against its own claims."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

import residua as rs
from exact import questions
from exact.matrices import block, rank
from exact.pencils import zero_polynomial
from exact.plants import ExactPlant
from exact.stability import distance_to_boundary
from exact_campaign.answers import Record, Subject
from exact_campaign.cases import units_of_faults
from exact_campaign.generators import examine_estimate, examine_generator

#: Rows of a structure that banks are asked for, attainable ones and others.
_ROWS = 3


def designs(subject: Subject) -> None:
    """Ask every design; by pseudoinverses in balanced units, for those in the units of a plant depend on them."""
    _observers(subject)
    _perfect(subject)
    _decoupled(subject)
    _banks_of_rows(subject)
    _parity(subject)
    _filters(subject)
    _estimators(subject)
    _scheme_banks(subject)
    _noise(subject)
    _from_elsewhere(subject)


def judged(record: Record, exists: bool | None, topic: str, *, close: bool = False, told: str = "") -> bool:
    """Compare made or refused with what exists exactly; tell whether there is something to look at."""
    answer = record.answer
    if answer.crash:
        return False
    if answer.refused:
        if exists and not answer.accuracy:
            text = f"{record.function} refuses what exists: {answer.refused[:250]} {told}"
            record.problem("close" if close else "wrong", topic, text)
        return False
    if exists is False:
        record.problem("close" if close else "wrong", topic, f"{record.function} returns what does not exist {told}")
    return True


def _near(X: ExactPlant, ignored: Sequence[int] = ()) -> bool:
    return distance_to_boundary(questions.fixed_polynomial(X, ignored), X.sampled) < 1e-7


# -------------------------------------------------------------------------------- observers


def _observers(subject: Subject) -> None:
    X, plant = subject.exact, subject.plant
    regular = _invertible(X)
    unknown = all(questions.unknown_input_observer(X))
    fewer = X.reading(range(X.p - 1))
    asked: list[tuple[str, Callable[[], Any], bool | None, bool]] = [
        (
            "luenberger_observer",
            lambda: rs.design.luenberger_observer(plant),
            regular and questions.detectable(X),
            False,
        ),
        ("unknown_input_observer", lambda: rs.design.unknown_input_observer(plant, scaling="even"), unknown, True),
        ("reduced_order_observer", lambda: rs.design.reduced_order_observer(plant), regular and unknown, True),
        ("descriptor_observer", lambda: rs.design.descriptor_observer(plant), unknown, True),
    ]
    if X.p > 1:
        few = list(range(X.p - 1))
        there = all(questions.unknown_input_observer(fewer))
        asked += [
            (
                "reduced_order_observer, one output held out",
                lambda: rs.design.reduced_order_observer(plant, outputs=few),
                regular and there,
                True,
            ),
            (
                "descriptor_observer, one output held out",
                lambda: rs.design.descriptor_observer(plant, outputs=few),
                there,
                True,
            ),
        ]
    for name, call, exists, decoupled in asked:
        record = subject.ask(name, call)
        if judged(record, exists, "observers", close=_near(X)):
            _observer(subject, record, decoupled, exists=None if "," not in name or np.any(plant.Dd) else True)
    _contradiction(subject, "unknown_input_observer_existence", "unknown_input_observer", "existence")


def _observer(subject: Subject, record: Record, decoupled: bool, exists: bool | None) -> None:
    made = record.answer.made
    record.facts = {"order": made.order, "fixed": len(made.evidence.fixed_poles)}
    examine_estimate(subject, record, made.system, subject.plant, decoupled)
    residual = subject.ask(f"{record.function}: residual", made.residual_generator)
    full = record.function in ("unknown_input_observer", "luenberger_observer")
    there = questions.residual_exists(subject.exact) if full and decoupled else True if full else exists
    if judged(residual, there, "observers"):
        examine_generator(subject, residual, residual.answer.made, subject.plant)


def _invertible(X: ExactPlant) -> bool:
    return rank(X.E) == X.n


def _contradiction(subject: Subject, analysis: str, design: str, topic: str) -> None:
    """Note where an analysis says that a design exists and the design refuses by a condition, or the other way."""
    said, made = subject.records[analysis].answer, subject.records[design].answer
    if said.made is None or made.crash or made.accuracy:
        return
    if bool(said.made) == bool(made.refused):
        text = f"{analysis} says {bool(said.made)}, {design}: {made.refused[:200] or 'made'}"
        subject.records[design].problem("contradiction", topic, text)


def _perfect(subject: Subject) -> None:
    X, plant = subject.exact, subject.plant
    q = X.Bd.ncols()
    exists = questions.generic_rank(X) == X.n + q and questions.fixed_polynomial(X).degree() == 0
    record = subject.ask("perfect_observer (least order)", lambda: rs.design.perfect_observer(plant, least_order=True))
    independent = rank(block([[X.Bd], [X.Dd]])) == q
    if judged(record, exists if independent else None, "perfect observers"):
        record.facts = {"index": record.answer.made.index}
    record = subject.ask("perfect_observer", lambda: rs.design.perfect_observer(plant))
    if judged(record, False if independent and not exists else None, "perfect observers"):
        record.facts = {"index": record.answer.made.index}


# -------------------------------------------------------------------------------- residuals that ignore


def _ignored_sets(subject: Subject) -> list[list[int]]:
    k = subject.exact.faults
    sets = [[], *([i] for i in range(k))]
    return sets + ([[0, k - 1]] if k > 2 else [])


def _decoupled(subject: Subject) -> None:
    X, plant = subject.exact, subject.plant
    for ignored in _ignored_sets(subject):
        names = [plant.faults[i] for i in ignored]
        record = subject.ask(
            f"decoupled_residual {ignored}",
            lambda names=names: rs.design.decoupled_residual(plant, insensitive_to=names),
        )
        if not judged(record, questions.residual_exists(X, ignored), "decoupled"):
            continue
        examine_generator(subject, record, record.answer.made, plant)
        made, seen = record.answer.made, questions.visible(X, ignored)
        fires = made.structure.any(axis=0).tolist()
        if fires != seen:
            record.problem("wrong", "structure", f"{record.function}: sees {fires}, exact {seen}")
        indices = questions.residual_indices(X, ignored)
        if made.n_residuals != len(indices):
            text = f"{record.function}: {made.n_residuals} residuals, exact {len(indices)}"
            record.problem("wrong", "decoupled order", text)
        if X.plain and made.system.n_states != sum(indices):
            text = f"{record.function}: order {made.system.n_states}, the least is {sum(indices)} ({indices})"
            record.problem("wrong", "decoupled order", text)
    _against_diagnosability(subject)


def _against_diagnosability(subject: Subject) -> None:
    """Compare what `diagnosability` promises with the residuals that ignore one fault each."""
    said = subject.records["diagnosability"].answer.made
    if said is None:
        return
    for ignored in _ignored_sets(subject)[: subject.exact.faults + 1]:
        record = subject.records[f"decoupled_residual {ignored}"]
        if record.answer.crash or record.answer.accuracy:
            continue
        promised = said.detectable if not ignored else said.isolable[:, ignored[0]]
        fires = np.zeros(len(promised), bool) if record.answer.refused else record.answer.made.structure.any(axis=0)
        if not np.array_equal(promised, fires):
            text = f"diagnosability says {promised.tolist()}, {record.function} sees {fires.tolist()}"
            record.problem("contradiction", "diagnosability and decoupled", text)


def _codes(subject: Subject) -> list[tuple[str, bool]]:
    """Return some rows, with whether they are attainable exactly: the first of each sort, spread over all."""
    X = subject.exact
    k = X.faults
    rows = [[bool(code >> i & 1) for i in range(k)] for code in range(2**k - 1, 0, -1)]
    found = [("".join("01"[x] for x in row), questions.attainable(X, row)) for row in rows]
    yes, no = [one for one in found if one[1]], [one for one in found if not one[1]]
    return yes[:: max(1, len(yes) // _ROWS)][:_ROWS] + no[:: max(1, len(no) // 2)][:2]


def _banks_of_rows(subject: Subject) -> None:
    plant = subject.plant
    for code, exists in _codes(subject):
        for name, design in (
            ("structured_bank", rs.design.structured_bank),
            ("structured_parity", rs.design.structured_parity),
        ):
            record = subject.ask(f"{name} {code}", lambda design=design, code=code: design(plant, [code]))
            if not judged(record, exists, "rows"):
                continue
            bank = record.answer.made
            examine_generator(subject, record, bank.generator, plant)
            wanted = [c == "1" for c in code]
            fires = bank.generator.structure.any(axis=0).tolist()
            if bank.structure[0].tolist() != wanted or fires != wanted:
                record.problem("wrong", "structure", f"{record.function}: {bank.structure.tolist()}, fires {fires}")


def _sizes(subject: Subject) -> dict[str, float]:
    """Return one base unit of each fault and disturbance in the units of the plant: the same expected sizes."""
    plant, by = subject.plant, subject.by
    units = np.concatenate([by.d, units_of_faults(plant, by)])
    return {name: float(1 / unit) for name, unit in zip((*plant.disturbances, *plant.faults), units, strict=True)}


def _parity(subject: Subject) -> None:
    X, plant = subject.exact, subject.plant
    for ignored in _ignored_sets(subject)[:2]:
        names = [plant.faults[i] for i in ignored]
        record = subject.ask(
            f"parity_relations {ignored}", lambda names=names: rs.design.parity_relations(plant, insensitive_to=names)
        )
        if judged(record, questions.residual_exists(X, ignored), "parity"):
            examine_generator(subject, record, record.answer.made, plant)
            indices, orders = questions.residual_indices(X, ignored), record.answer.made.relations.orders
            wanted = [i for i in indices if i == min(indices)]
            if X.plain and sorted(orders) != wanted:
                record.problem("wrong", "parity", f"{record.function}: orders {orders}, exact {wanted}")
    record = subject.ask("parity_orders", lambda: rs.design.parity_orders(plant))
    if judged(record, True, "parity") and X.plain:
        wanted = {}
        for code in range(1, 2**X.p):
            rows = [i for i in range(X.p) if code >> i & 1]
            part = X.reading(rows)
            if questions.residual_exists(part):
                wanted[tuple(plant.outputs[i] for i in rows)] = min(questions.residual_indices(part))
        record.facts = {"orders": {"+".join(k): v for k, v in record.answer.made.items()}}
        if record.answer.made != wanted:
            different = {k: (record.answer.made.get(k), wanted.get(k)) for k in wanted | record.answer.made}
            different = {k: v for k, v in different.items() if v[0] != v[1]}
            record.problem("wrong", "parity", f"parity_orders (said, exact): {different}")
    least, sizes = max(questions.residual_indices(X), default=0), _sizes(subject)
    # by its order, which is another where the floats of the plant are another plant
    record = subject.ask(f"optimal_parity ({least})", lambda: rs.design.optimal_parity(plant, order=least, sizes=sizes))
    sees = X.plain and not X.Bd.ncols() and any(questions.visible(X))
    if judged(record, True if sees else None, "parity"):
        examine_generator(subject, record, record.answer.made.generator, plant)
    record = subject.ask("primary_residuals", lambda: rs.design.primary_residuals(plant))
    if judged(record, True if X.plain else None, "parity"):
        examine_generator(subject, record, record.answer.made, plant)
    if X.faults > 1:
        directions = {plant.faults[0]: [1.0, 0.0], plant.faults[1]: [0.0, 1.0]}
        rest = list(plant.faults[2:3])
        record = subject.ask(
            "directional_parity",
            lambda: rs.design.directional_parity(plant, directions=directions, insensitive_to=rest),
        )
        if judged(record, None, "parity"):
            examine_generator(subject, record, record.answer.made, plant)


# -------------------------------------------------------------------------------- directions and estimates


def _filters(subject: Subject) -> None:
    plant = subject.plant
    asked: list[tuple[str, Callable[[], Any]]] = [
        ("detection_filter", lambda: rs.design.detection_filter(plant, scaling="even")),
        ("robust_detection_filter", lambda: rs.design.robust_detection_filter(plant, scaling="even")),
    ]
    for side in ("right", "left"):
        asked.append(
            (
                f"eigenstructure_assignment ({side})",
                lambda side=side: rs.design.eigenstructure_assignment(
                    plant, side=side, insensitive_to=plant.faults[:1]
                ),
            )
        )
    for name, call in asked:
        record = subject.ask(name, call)
        if judged(record, None, "filters"):
            examine_generator(subject, record, record.answer.made, plant)


def _estimators(subject: Subject) -> None:
    X, plant = subject.exact, subject.plant
    for name, chosen in (("fault_estimator, first fault", [0]), ("fault_estimator, all faults", list(range(X.faults)))):
        names = [plant.faults[i] for i in chosen]
        record = subject.ask(name, lambda names=names: rs.design.fault_estimator(plant, faults=names))
        there = all(questions.unknown_input_observer(X, chosen)) and _independent(X, chosen) and _corrected(X, chosen)
        if judged(record, there, "estimators", close=_near(X, chosen)):
            made = record.answer.made
            examine_generator(subject, record, made.generator, plant)
            examine_estimate(subject, record, made.observer.system, plant, True)
    record = subject.ask("sensor_fault_estimators", lambda: rs.design.sensor_fault_estimators(plant))
    judged(record, None, "estimators")
    record = subject.ask("inverse_form_observer", lambda: rs.design.inverse_form_observer(plant))
    judged(record, None, "estimators")


def _corrected(X: ExactPlant, chosen: Sequence[int]) -> bool:
    r"""Tell whether a measurement corrects an estimate that ignores faults, or there is no pole to correct.

    The fixed poles of the error are the invariant zeros of the pencil with disturbances and ignored faults. Where the
    pencil has full column rank these are at most as many as the poles of the plant, :math:`\deg\det(sE - A)`. Where
    they are as many, its Kronecker form has no row index above zero and no infinite zero of higher order: the unknown
    inputs enter the outputs at once, and no output that they leave sees the state. Sueur's observer for the faults of
    all sensors is this case, whose fixed poles are the eigenvalues of ``A``. Where they are fewer, measurements enter
    the estimate; all poles that are not zeros are of choice, and with stable zeros the estimate converges to the fault.
    That some residual ignores the faults (a row index above zero) is no condition: an estimate of as many faults as
    there are outputs is an inverse of the plant.
    """
    fixed = questions.fixed_polynomial(X, chosen).degree()
    return fixed == 0 or fixed < zero_polynomial((X.A, -X.E)).degree()


def _independent(X: ExactPlant, chosen: Sequence[int]) -> bool:
    """Tell whether the effects of faults are independent of one another and of the disturbances."""
    B, D = X.ignoring(chosen)
    return rank(block([[B], [D]])) == rank(block([[X.Bd], [X.Dd]])) + len(chosen)


def _scheme_banks(subject: Subject) -> None:
    plant = subject.plant
    asked: list[tuple[str, Callable[[], Any]]] = []
    for kind in ("unknown-input", "minimal", "reduced-order"):
        asked += [
            (
                f"sensor_fault_bank ({kind})",
                lambda kind=kind: rs.design.sensor_fault_bank(plant, observer=kind, allow_missing=True),
            ),
            (
                f"actuator_fault_bank ({kind})",
                lambda kind=kind: rs.design.actuator_fault_bank(plant, observer=kind, allow_missing=True),
            ),
        ]
    for scheme, design in (("sensor", rs.design.sensor_fault_bank), ("actuator", rs.design.actuator_fault_bank)):
        asked.append(
            (
                f"{scheme}_fault_bank (dedicated, minimal)",
                lambda design=design: design(plant, scheme="dedicated", observer="minimal", allow_missing=True),
            )
        )
    for name, call in asked:
        record = subject.ask(name, call)
        if judged(record, None, "banks"):
            bank = record.answer.made
            examine_generator(subject, record, bank.generator, bank.plant)
            record.facts |= {"members": list(bank.members), "failures": dict(bank.failures)}


def _from_elsewhere(subject: Subject) -> None:
    """Hand the matrices of designs back as those of an observer from elsewhere: they must be taken as what they are."""
    plant = subject.plant
    luenberger = subject.records["luenberger_observer"].answer.made
    if luenberger is not None:
        record = subject.ask(
            "residual_generator_from_observer (gain)",
            lambda: rs.residual_generator_from_observer(plant, gain=luenberger.K),
        )
        if judged(record, True, "from elsewhere"):
            examine_generator(subject, record, record.answer.made, plant)
    made = subject.records["decoupled_residual []"].answer.made
    if made is None or not subject.exact.plain:
        return
    form = subject.ask("general_form", lambda: rs.design.general_form(made))
    if form.answer.made is None:
        return
    g = form.answer.made
    matrices = {name: getattr(g, name) for name in ("M", "J", "N", "Ls", "Lu", "Ly", "T")}
    record = subject.ask(
        "residual_generator_from_observer (matrices)",
        lambda: rs.residual_generator_from_observer(plant, **matrices),
    )
    if judged(record, True, "from elsewhere"):
        examine_generator(subject, record, record.answer.made, plant)


def _noise(subject: Subject) -> None:
    X = subject.exact
    record = subject.ask("kalman_filter", lambda: rs.design.kalman_filter(subject.noisy))
    if judged(record, _invertible(X) and questions.detectable(X), "noise"):
        examine_generator(subject, record, record.answer.made, subject.noisy)
    if X.sampled:
        record = subject.ask("matched_filters", lambda: rs.design.matched_filters(subject.noisy))
        judged(record, None, "noise")
    for ignored in ([], [0]):
        names = [subject.plant.faults[i] for i in ignored]
        record = subject.ask(
            f"decoupled_residual, with noise {ignored}",
            lambda names=names: rs.design.decoupled_residual(subject.noisy, insensitive_to=names),
        )
        if judged(record, questions.residual_exists(X, ignored), "decoupled"):
            examine_generator(subject, record, record.answer.made, subject.noisy)
