"""Every guard of the evidence of a design notices: a wrong intermediate result is refused, not handed on.

Most plants here are well conditioned, so that nothing would trip by itself: one inner function is made to give a result
that is off by a thousandth, and the guard behind it must say so.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import residua as rs
from guards import changed, trips
from residua.design.banks.bank import Wanted, check_promise
from residua.design.core.decoupling import Approximate, Decoupled
from residua.design.core.evidence import Evidence
from residua.design.core.generator import make_generator
from residua.design.core.internal_form import state_covariance
from residua.design.observers.observer import with_checked_estimate
from residua.design.observers.perfect_observer import perfect_observer
from residua.design.parity.conversion import to_parity
from residua.design.parity.directions import check_directions
from residua.errors import AccuracyError

#: By how much wrong results are off: small enough to look right, and far above every tolerance of the evidence.
OFF = 1e-3
D = rs.design
Bases = dict[str, NDArray[np.float64]]


def off(value: Any) -> Any:
    """A matrix with its largest entry off by a thousandth: rescaling it all could leave what it promises."""
    out = np.array(value)
    if out.size:
        out.flat[int(np.argmax(np.abs(out)))] *= 1 + OFF
    return out


def _times(value: Any, *names: str) -> Any:
    """An object whose arrays are all a thousandth too large."""
    return replace(value, **{name: (1 + OFF) * getattr(value, name) for name in names})


def gertler() -> rs.Plant:
    return rs.library.gertler()


def engine() -> rs.Plant:
    return rs.library.jet_engine()


def ordinary() -> rs.Plant:
    """Three states, two outputs, one disturbance."""
    return rs.library.twardy()


def algebraic() -> rs.Plant:
    plant = rs.Plant([[1, 2], [3, 4]], [[1], [1]], [[1, 1]], E=[[1, 0], [0, 0]])
    return plant.with_actuator_faults().with_sensor_faults()


def without_dynamics() -> rs.Plant:
    """The second sensor reads what does not move: its fault keeps a line, where a plane is promised."""
    return rs.Plant([[0.5, 0], [0, 0]], [[1], [0]], np.eye(2), dt=1.0).with_sensor_faults()


def estimator() -> Any:
    return D.fault_estimator(rs.library.vtol(), faults=["collective actuator", "cyclic actuator"])


def inverse() -> Any:
    faults, poles = ["collective actuator", "cyclic actuator"], [-20, -25, -100 / 3, -50]
    return D.inverse_form_observer(rs.library.vtol(), faults=faults, poles=poles)


def directional() -> Any:
    return D.directional_parity(gertler(), directions={"p1": [2, 1], "p2": [1, 2]})


def assigned() -> Any:
    return D.eigenstructure_assignment(gertler(), insensitive_to="p1", poles=[0, 0.25, 0.3])


def ignoring() -> Any:
    return D.decoupled_residual(gertler(), insensitive_to="p1", poles=[0.25, 0.3])


Change = Callable[[Any], Any]

#: The guard; the inner function that is wrong, and how; what is designed.
WRONG = [
    pytest.param(
        "design.detection_filters.detection_filter:block_gain",
        lambda gain: replace(gain, K=off(gain.K)),
        lambda: D.detection_filter(gertler(), poles=[0.25, 0.3, 0.6]),
        marks=trips("design.detection_filters.directional_gain:with_poles_of_whole"),
        id="gain of a detection filter",
    ),
    pytest.param(
        "design.detection_filters.eigenstructure_assignment:_right_gain",
        lambda gain: replace(gain, K=-3 * gain.K),
        assigned,
        marks=trips("design.detection_filters.eigenstructure_assignment:_generator"),
        id="stability of assigned eigenvectors",
    ),
    pytest.param(
        "design.estimation.fault_estimator:_read_faults",
        lambda reading: _times(reading, "static", "derivative", "dynamics"),
        estimator,
        marks=trips("design.estimation.fault_estimator:fault_estimator"),
        id="reading of an estimator",
    ),
    pytest.param(
        "design.estimation.fault_estimator:_read_faults",
        lambda reading: _times(reading, "static", "derivative", "dynamics"),
        lambda: D.sensor_fault_estimators(rs.library.vtol(), poles=[-30, -40, -40, -50]),
        marks=trips("design.estimation.sensor_fault_estimators:sensor_fault_estimators"),
        id="estimates of every sensor",
    ),
    pytest.param(
        "design.estimation.fault_estimator:_inverse",
        off,
        estimator,
        marks=trips("design.estimation.fault_estimator:_read_faults"),
        id="faults read off",
    ),
    pytest.param(
        "design.observers.inverse_form_observer:_placed",
        lambda placed: (off(placed[0]), placed[1]),
        inverse,
        marks=trips("design.observers.inverse_form_observer:_observer:2"),
        id="poles of the inverse form",
    ),
    pytest.param(
        "linear.poles.pole_assignment:spectrum_error",
        lambda found: (OFF, found[1], False),
        lambda: D.unknown_input_observer(ordinary(), poles=[-2, -2 + 1j, -2 - 1j]),
        marks=trips("linear.poles.pole_assignment:assigned_gain"),
        id="poles of an observer",
    ),
    pytest.param(
        "linear.poles.observer_gain:_least_squares",
        lambda gain: None,
        lambda: D.luenberger_observer(gertler()),
        marks=trips("linear.poles.observer_gain:observer_gain"),
        id="gain of an observer",
    ),
    pytest.param(
        "design.observers.perfect_gain:deadbeat",
        lambda found: None,
        lambda: perfect_observer(algebraic(), least_order=True),
        marks=trips("design.observers.perfect_gain:least_order_gain"),
        id="steps of least order",
    ),
    pytest.param(
        "design.observers.perfect_gain:_random_gains",
        lambda gains: iter(()),
        lambda: perfect_observer(algebraic()),
        marks=trips("design.observers.perfect_gain:full_rank_gain"),
        id="steps of full rank",
    ),
    pytest.param(
        "design.observers.perfect_observer:full_rank_gain",
        lambda gain: replace(gain, G=off(gain.G)),
        lambda: perfect_observer(algebraic()),
        marks=trips("design.observers.perfect_observer:_estimate_off"),
        id="estimate of a perfect observer",
    ),
    pytest.param(
        "design.parity.conversion:without_common_factor",
        lambda found: (np.hstack([found[0][:, :3], off(found[0][:, 3:])]), *found[1:]),
        lambda: to_parity(replace(ignoring(), relations=None)),
        marks=trips("design.parity.conversion:_row"),
        id="relation of a filter",
    ),
    pytest.param(
        "design.parity.relations:realize_relation",
        lambda part: replace(part, B=off(part.B)),
        lambda: D.parity_relations(gertler(), insensitive_to="p1", poles=[0, 0]),
        marks=trips("design.core.decoupling:_accepted"),
        id="filter of a relation",
    ),
    pytest.param(
        "design.parity.relations:realize_relation",
        lambda part: replace(part, B=1e60 * part.B),
        lambda: D.parity_relations(gertler(), insensitive_to="p1", poles=[0, 0]),
        marks=trips("design.parity.relations:_generator"),
        id="filter of a relation whose newest sample is lost",
    ),
    pytest.param(
        "design.parity.relations:realize_relation",
        lambda part: replace(part, state_map=off(part.state_map)),
        lambda: D.parity_relations(gertler(), insensitive_to="p1", poles=[0, 0]),
        marks=trips("design.core.decoupling:_accept"),
        id="state map of a relation",
    ),
    pytest.param(
        "design.parity.relations:ParityRelations._moved",
        lambda rows: [replace(row, p=off(row.p)) for row in rows],
        lambda: D.parity_relations(gertler(), insensitive_to="p1", poles=[0, 0]),
        marks=trips("design.core.decoupling:_accepted"),
        id="coefficients of a relation",
    ),
    pytest.param(
        "design.parity.relations:lost_digits",
        lambda lost: 14.0,
        lambda: D.parity_relations(gertler(), insensitive_to="p1", poles=[0, 0]),
        marks=trips("design.parity.relations:_on_poles"),
        id="leak of a relation beside its faults",
    ),
    pytest.param(
        "design.parity.relations:lost_digits",
        lambda lost: 14.0,
        directional,
        marks=trips("design.parity.directional_parity:directional_parity"),
        id="leak of directional relations beside their faults",
    ),
    pytest.param(
        "design.parity.directional_parity:relation_space",
        lambda found: replace(found, responses=0.0 * found.responses),
        directional,
        marks=trips("design.parity.directional_parity:_solution"),
        id="solutions of directional relations",
    ),
]


@pytest.mark.parametrize(("target", "change", "design"), WRONG)
def test_a_wrong_result_is_refused(
    target: str, change: Change, design: Callable[[], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    design()  # nothing is refused as it is
    changed(monkeypatch, target, change)
    with pytest.raises(AccuracyError):
        design()


@trips("design.observers.observer:with_checked_estimate")
@pytest.mark.parametrize("design", [D.luenberger_observer, D.unknown_input_observer, D.reduced_order_observer])
def test_an_estimate_that_is_off_is_refused(design: Callable[[rs.Plant], Any]) -> None:
    observer = design(gertler())
    with_checked_estimate(observer)
    with pytest.raises(AccuracyError, match="off the state"):
        with_checked_estimate(replace(observer, K=off(observer.K)))


@trips("design.core.internal_form:state_covariance:2")
def test_a_covariance_that_misses_its_equation_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    A, Q = np.diag([0.5, 0.2]), np.eye(2)
    np.testing.assert_allclose(state_covariance(A, Q), np.diag([4 / 3, 1 / 0.96]), rtol=1e-12)
    changed(monkeypatch, "design.core.internal_form:np.linalg.norm", lambda value: 1.0)
    with pytest.raises(AccuracyError, match="misses its equation"):
        state_covariance(A, Q)


@trips("design.core.internal_form:state_covariance:1")
@pytest.mark.parametrize("pole", [1.0, -1.0, 1.5])
def test_what_does_not_settle_has_no_covariance(pole: float) -> None:
    with pytest.raises(AccuracyError, match="does not settle"):
        state_covariance(np.diag([pole, 0.2]), np.eye(2))


def test_a_predictor_with_all_poles_at_zero_has_its_covariance() -> None:
    """A chain of delays with gains from 1e-6 to 1e6: what a sum of as many powers says as there are states."""
    rng = np.random.default_rng(0)
    A = np.diag(10.0 ** rng.uniform(-6, 6, 12), 1)
    Q = np.eye(13)
    powers = [np.linalg.matrix_power(A, k) for k in range(13)]
    np.testing.assert_allclose(state_covariance(A, Q), sum(P @ Q @ P.T for P in powers), rtol=1e-12)


@trips("design.banks.bank:check_promise")
def test_a_member_that_answers_to_what_it_ignores_is_refused() -> None:
    member = D.decoupled_residual(gertler(), insensitive_to="p1", poles=[0.25, 0.3])
    check_promise(member, Wanted("without p1", ("p1",), ("p2",)))
    with pytest.raises(AccuracyError, match="answers to p2"):
        check_promise(member, Wanted("without p2", ("p2",), ()))


def _silent(found: tuple[Bases, float]) -> tuple[Bases, float]:
    bases, off_them = found
    return {name: one[:, :0] for name, one in bases.items()}, off_them


@trips("design.detection_filters.detection_filter:_stacked")
def test_a_fault_that_leaves_its_direction_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    D.detection_filter(gertler())
    D.detection_filter(without_dynamics())
    changed(monkeypatch, "design.core.generator:signatures_of", lambda found: (_whole(found[0]), found[1]))
    with pytest.raises(AccuracyError, match="leaves its direction"):
        D.detection_filter(gertler())


def _whole(bases: Bases) -> Bases:
    return {name: np.eye(len(one)) for name, one in bases.items()}


@trips("design.parity.structured_parity:relation_of")
def test_a_relation_whose_response_is_lost_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    D.structured_parity(gertler(), {"r1": ["p1"]})
    changed(monkeypatch, "design.core.generator:signatures_of", _silent)
    with pytest.raises(AccuracyError, match="lost in the rounding"):
        D.structured_parity(gertler(), {"r1": ["p1"]})


@trips("design.parity.directions:check_directions")
@pytest.mark.parametrize("wrong", ["direction", "response", "plane", "nothing"])
def test_directional_relations_that_miss_their_directions_are_refused(
    wrong: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = directional()
    wanted = made.relations.directions
    assert check_directions(made, wanted) < 1e-9
    if wrong == "direction":
        wanted = replace(wanted, vectors=off(wanted.vectors))
    elif wrong == "response":
        changed(
            monkeypatch, "linear.systems.state_space:StateSpace.frequency_response", lambda response: 0.0 * response
        )
    else:
        basis = np.eye(made.n_residuals) if wrong == "plane" else np.zeros((made.n_residuals, 0))
        made = replace(made, subspaces=dict.fromkeys(made.faults, basis))
    with pytest.raises(AccuracyError, match="misses its direction"):
        check_directions(made, wanted)


@trips("design.parity.shortest:shortest_space")
def test_a_relation_that_exists_and_is_not_found_is_no_missing_one(monkeypatch: pytest.MonkeyPatch) -> None:
    D.structured_parity(gertler(), {"r1": ["p2"]})
    changed(
        monkeypatch,
        "design.parity.shortest:relation_space",
        lambda found: replace(found, responses=0.0 * found.responses),
    )
    with pytest.raises(AccuracyError, match="is found to working precision"):
        D.structured_parity(gertler(), {"r1": ["p2"]})


@trips("design.parity.equivalence:realization", "design.parity.equivalence:_matched")
def test_a_transformation_that_is_off_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    kalman = D.kalman_filter(gertler().with_noise(process=1e-2, measurement=1e-2))
    whole = kalman.equivalent_to(D.luenberger_observer(gertler(), poles=[0.1, 0.2, 0.3]).residual_generator())
    whole.realization()
    changed(monkeypatch, "design.parity.equivalence:_minimal", lambda s: s.replaced(C=off(s.C)))
    with pytest.raises(AccuracyError, match="misses its frequency response"):
        whole.realization()
    one, other = ignoring(), D.parity_relations(gertler(), insensitive_to="p1")
    assert len(other.equivalent_to(one).rows) == 1
    target = "design.parity.equivalence:RowTransformation.evaluate"
    changed(monkeypatch, target, lambda value: value * np.exp(1j * np.arange(len(value))))
    found = other.equivalent_to(one)
    assert not found.rows
    assert "filters made of them miss by" in found.note


# ------------------------------------------------------------------ the gate


def _made(system: Any = None, **changes: Any) -> Any:
    """Make the generator of an unknown input observer again, with changes."""
    good = D.unknown_input_observer(engine()).residual_generator()
    options = {"decouples": Decoupled(), "state_map": good.state_map, "static_map": good.static_map} | changes
    return make_generator(
        good.system if system is None else system(good.system), good.plant, "x", Evidence("x"), **options
    )


@trips("design.core.generator:make_generator")
def test_an_unstable_filter_cannot_be_made() -> None:
    _made()
    with pytest.raises(AccuracyError, match="not stable"):
        _made(lambda s: s.replaced(A=-s.A))


@trips("design.core.decoupling:_accepted")
@pytest.mark.parametrize("column", [0, 1])
def test_a_filter_that_controls_or_disturbances_reach_cannot_be_made(column: int) -> None:
    _made()
    with pytest.raises(AccuracyError, match="residual answers to the"):
        _made(lambda s: s.replaced(B=np.where(np.arange(s.n_inputs) == column, 1 + OFF, 1.0) * s.B))


@trips("design.core.decoupling:_accepted")
def test_a_fault_that_is_not_ignored_is_named() -> None:
    good = ignoring()
    with pytest.raises(AccuracyError, match="answers to p2, which it should ignore"):
        make_generator(
            good.system, good.plant, "x", Evidence("x"), decouples=Decoupled(faults=("p2",)), state_map=good.state_map
        )


@trips("design.core.decoupling:_accept")
def test_the_state_map_of_another_filter_is_refused() -> None:
    good = D.unknown_input_observer(engine()).residual_generator()
    with pytest.raises(AccuracyError, match="check its state_map"):
        _made(state_map=off(good.state_map))


def test_an_approximate_design_says_how_far_inputs_reach_it() -> None:
    with pytest.raises(TypeError, match="no 'leak'"):
        _made(decouples=Approximate("leak"), state_map=None)


def test_the_state_map_of_an_exact_design_is_found_where_it_is_not_given() -> None:
    given, found = _made(), _made(state_map=None)
    np.testing.assert_allclose(found.state_map, given.state_map, atol=1e-9 * np.abs(given.state_map).max())
    np.testing.assert_array_equal(found.structure, given.structure)
