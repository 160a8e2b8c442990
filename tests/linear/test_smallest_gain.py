from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from continuous_examples import continuous
from residua.errors import DesignError, ModelError, SettingError
from residua.linear import StateSpace, UncertainSystem, smallest_gain
from uncertain_examples import jet_engine, jet_engine_controller, random_uncertain_system


def response(system: UncertainSystem, f: np.ndarray, omega: float) -> np.ndarray:
    """Return the frequency response of one member, from its definition."""
    m = system.member(f)
    z = np.exp(1j * omega * m.dt) if m.dt else 1j * omega
    return m.C @ np.linalg.solve(z * np.eye(len(m.A)) - m.A, m.B) + m.D


def gain(system: UncertainSystem, f: np.ndarray, omega: float) -> float:
    """Return the smallest output of one member for inputs of unit size."""
    T = response(system, f, omega)
    return float(np.linalg.svd(T, compute_uv=False)[-1]) if T.shape[0] >= T.shape[1] else 0.0


def smallest_of_many(system: UncertainSystem, band: float, count: int, seed: int) -> float:
    """Return the smallest gain of corners and of members at random, at both ends of the band and in between."""
    rng = np.random.default_rng(seed)
    points = np.vstack([system.sample(rng, count), system.vertices()])
    omega = rng.uniform(0, band, len(points))
    omega[::3], omega[1::3] = 0.0, band
    if system.Dzw.shape[0] < system.Dzw.shape[1]:
        return 0.0
    # All at once: the definition of a member, and that of its response.
    F = points[:, list(system.channels), None] * system.Cq
    A, C = system.A + system.Bp @ F, system.Cz + system.Dzp @ F
    z = np.exp(1j * omega * system.dt) if system.dt else 1j * omega
    B = np.broadcast_to(system.Bw, (len(z), *system.Bw.shape))
    T = C @ np.linalg.solve(z[:, None, None] * np.eye(system.n_states) - A, B) + system.Dzw
    gains = np.linalg.svd(T, compute_uv=False)[:, -1]
    i = int(gains.argmin())
    assert gains[i] == pytest.approx(gain(system, points[i], omega[i]), rel=1e-9, abs=1e-12)
    return float(gains[i])


def check(system: UncertainSystem, band: float, count: int = 40, seed: int = 0):
    """Check the bound against members at random, and what is attained against its definition; return it."""
    found = smallest_gain(system, band=band)
    assert 0 <= found.bound <= found.attained
    assert 0 <= found.frequency <= band
    assert found.bound <= smallest_of_many(system, band, count, seed) * (1 + 1e-9)
    there = gain(system, np.array([found.values[name] for name in system.parameters]), found.frequency)
    assert there == pytest.approx(found.attained, rel=1e-9, abs=1e-9)
    return found


def test_lag_with_an_uncertain_pole():
    lag = UncertainSystem([[0.5]], [[1]], [[2]], [[1]], [[3]], low=[-0.1], high=[0.3], parameters=["pole"], dt=0.1)
    found = check(lag, 0.0)
    assert found.bound == pytest.approx(6 / (1 - 0.4), rel=1e-9)
    assert (found.values, found.frequency, found.note) == ({"pole": -0.1}, 0.0, "")
    assert found.ratio == pytest.approx(1, rel=1e-9)
    assert float(found) == found.bound
    # |e^jw - a|, which is largest at the end of the band: slow poles lose more of a fast fault.
    for band in (1.0, 10.0, 10 * np.pi):
        a = np.linspace(0.4, 0.8, 401)
        exact = (6 / np.abs(np.exp(0.1j * band) - a)).min()
        found = check(lag, band)
        assert found.attained == pytest.approx(exact, rel=1e-6)
        assert 0.99 * exact <= found.bound <= exact
        assert found.frequency == pytest.approx(band)


def test_continuous_lag():
    lag = UncertainSystem([[-2]], [[1]], [[4]], [[1]], [[1]], low=[-1], high=[1])
    assert smallest_gain(lag).bound == pytest.approx(4 / 3, rel=1e-9)
    for band in (1.0, 1e3, 1e6):
        found = check(lag, band)
        assert found.attained == pytest.approx(4 / np.hypot(3, band), rel=1e-6)
        assert found.ratio >= 0.99


def check_tightness(seeds: range, make, band: float) -> tuple[int, int, int]:
    """Count systems with a gain above zero, those with a bound within 2 % of it, and those without any bound."""
    positive = tight = none = 0
    for seed in seeds:
        system = make(seed)
        found = check(system, band, seed=seed)
        if found.attained > 0:
            positive, tight, none = positive + 1, tight + (found.ratio >= 0.98), none + (found.bound == 0)
    return positive, tight, none


# Of 200 systems 60 or so have a member whose gain is zero, or fewer outputs than inputs; of the first 40, 19. Some need
# more boxes for the whole circle.
@pytest.mark.parametrize("band", [0.0, 0.5, np.pi])
def test_no_member_falls_below_the_bound(band):
    count = 40 if band > 1 else 80
    positive, tight, none = check_tightness(range(count), random_uncertain_system, band)
    assert positive >= count // 2
    assert tight >= positive - 2 * (band > 1)
    assert none == 0


@pytest.mark.campaign
@pytest.mark.parametrize("band", [0.0, 0.5, np.pi])
def test_no_member_falls_below_the_bound_many(band):
    positive, tight, _ = check_tightness(range(40, 1000), random_uncertain_system, band)
    assert tight >= 0.98 * positive


@pytest.mark.parametrize("band", [0.0, 1.0, 1000.0])
def test_continuous_systems(band):
    positive, tight, _ = check_tightness(range(30), lambda seed: continuous(random_uncertain_system(seed)), band)
    assert positive >= 18
    assert tight >= positive - 1


@pytest.mark.parametrize("band", [0.0, 0.5])
@pytest.mark.parametrize("seed", range(12))
def test_states_and_channels_in_any_units(seed, band):
    s = random_uncertain_system(seed)
    rng = np.random.default_rng(seed)
    u, c = 10.0 ** rng.integers(-6, 7, s.n_states), 10.0 ** rng.integers(-6, 7, len(s.channels))
    other = UncertainSystem(
        s.A / u[:, None] * u, s.Bp / u[:, None] * c, s.Bw / u[:, None],
        s.Cq * u / c[:, None], s.Cz * u, s.Dzp * c, s.Dzw,
        low=s.low, high=s.high, channels=s.channels, dt=s.dt,
    )  # fmt: skip
    found, plain = smallest_gain(other, band=band), smallest_gain(s, band=band)
    assert found.attained == pytest.approx(plain.attained, rel=1e-6)
    assert found.bound == pytest.approx(plain.bound, rel=1e-2)


def test_inputs_outputs_and_parameters_in_any_units():
    s = random_uncertain_system(5)
    plain = smallest_gain(s, band=0.2)
    big = UncertainSystem(
        s.A, 1e6 * s.Bp, 1e-6 * s.Bw, s.Cq, 1e12 * s.Cz, 1e18 * s.Dzp, 1e6 * s.Dzw,
        low=1e-6 * s.low, high=1e-6 * s.high, channels=s.channels, dt=s.dt,
    )  # fmt: skip
    assert plain.bound > 0
    assert smallest_gain(big, band=0.2).bound == pytest.approx(1e6 * plain.bound, rel=1e-6)


def test_a_parameter_in_two_places_is_not_two_parameters():
    # z = x1 - x2 with x1+ = (0.5 + f) x1 + 2 w, x2+ = (0.5 + f) x2 + w: gain 1 / (0.5 - f), never zero.
    A, Bw, Cz = 0.5 * np.eye(2), [[2], [1]], [[1, -1]]
    one = UncertainSystem(A, np.eye(2), Bw, np.eye(2), Cz, low=-0.3, high=0.3, channels=[0, 0], dt=1)
    two = UncertainSystem(A, np.eye(2), Bw, np.eye(2), Cz, low=[-0.3, -0.3], high=[0.3, 0.3], dt=1)
    assert check(one, 0.0).bound == pytest.approx(1 / 0.8, rel=1e-2)
    found = check(two, 0.0)
    assert (found.bound, found.attained, found.ratio) == (0.0, 0.0, 1.0)
    assert "zero but for rounding" in found.note


def test_gain_of_zero_inside_the_set():
    # 1 / (1 - 0.5) + f crosses zero at f = -2; at the corners it is -1 and 1.
    crossing = UncertainSystem([[0.5]], [[0]], [[1]], [[1]], [[1]], [[0.5]], low=-3, high=-1, dt=1)
    for system in (crossing, crossing.within([-2.0], [1.0])):
        found = smallest_gain(system)
        assert found.bound == found.attained == 0.0
        assert found.values["f1"] == pytest.approx(-2)
    # Next to it, not on it: as small as it is.
    near = smallest_gain(crossing.within([-3.0], [-2.0 - 1e-6]))
    assert near.bound == pytest.approx(1e-6, rel=1e-2)


def test_gain_that_is_zero_but_for_rounding():
    # The parts cancel to 1e-17; no bound may be made of that.
    system = UncertainSystem([[0.9]], [[0]], [[0.1]], [[1]], [[0.7]], None, [[-0.7]], low=-1, high=1, dt=1)
    assert abs(response(system, np.zeros(1), 0.0)[0, 0]) < 1e-14
    assert smallest_gain(system).bound == 0.0
    mute = UncertainSystem([[0.5]], [[1]], [[1]], [[1]], [[0]], low=0, high=0.1, dt=1)
    assert smallest_gain(mute, band=1.0).bound == 0.0


def test_transmission_zero_in_the_band():
    # w - 2 cos(1) w_before + w_twice_before is zero at 1 rad/sample; a lag with an uncertain pole follows.
    A = [[0, 0, 0], [1, 0, 0], [-2 * np.cos(1.0), 1, 0.5]]
    notch = UncertainSystem(A, [[0], [0], [1]], [[1], [0], [1]], [[0, 0, 1]], [[0, 0, 1]], low=-0.2, high=0.2, dt=0.1)
    below = check(notch, 9.0)
    assert below.ratio >= 0.99
    assert below.frequency == pytest.approx(9.0)
    found = smallest_gain(notch, band=12.0)
    assert found.bound == found.attained == 0.0
    assert found.frequency == pytest.approx(10.0)


def test_several_inputs_and_outputs():
    # Two lags, turned: the singular values are the gains of the lags.
    c, s = np.cos(0.3), np.sin(0.3)
    turn, back = np.array([[c, s], [-s, c]]), np.array([[s, -c], [c, s]])
    A = np.diag([0.5, 0.2])
    lags = UncertainSystem(A, np.eye(2), back, np.eye(2), turn, low=[-0.4, -0.1], high=[0.3, 0.2], dt=1)
    assert check(lags, 0.0).bound == pytest.approx(1 / 0.9, rel=1e-2)
    found = check(lags, np.pi)
    assert found.bound == pytest.approx(1 / 1.8, rel=1e-2)
    assert found.values["f1"] == pytest.approx(0.3)
    # A third output adds; a third input leaves a combination without any output.
    tall = UncertainSystem(
        A, np.eye(2), back, np.eye(2), np.vstack([turn, [[1, 0]]]), low=lags.low, high=lags.high, dt=1
    )
    assert check(tall, np.pi).bound >= 0.99 * found.bound
    wide = UncertainSystem(A, np.eye(2), np.ones((2, 3)), np.eye(2), turn, low=lags.low, high=lags.high, dt=1)
    found = smallest_gain(wide)
    assert (found.bound, found.attained) == (0.0, 0.0)
    assert "more inputs (3) than outputs (2)" in found.note


def test_one_input_much_larger_than_the_other():
    system = random_uncertain_system(108)
    assert system.Dzw.shape == (2, 2)
    scaled = UncertainSystem(
        system.A, system.Bp, system.Bw * [1, 1e6], system.Cq, system.Cz, system.Dzp, system.Dzw * [1, 1e6],
        low=system.low, high=system.high, channels=system.channels, dt=1,
    )  # fmt: skip
    assert check(scaled, 0.0).ratio >= 0.98


def test_nothing_uncertain():
    A, B, C, D = [[0.5, 0.2], [-0.1, 0.7]], [[1], [2]], [[1, 1]], [[0.1]]
    exact = float(StateSpace(A, B, C, D, dt=1).dc_gain()[0, 0])
    none = UncertainSystem(A, np.zeros((2, 0)), B, np.zeros((0, 2)), C, None, D, low=[], high=[], dt=1)
    fixed = UncertainSystem(A, [[1], [0]], B, [[1, 1]], C, None, D, low=[0.0], high=[0.0], dt=1)
    for system in (none, fixed):
        found = smallest_gain(system)
        assert found.bound == pytest.approx(exact, rel=1e-9)
        assert found.attained == pytest.approx(exact, rel=1e-12)
        assert found.boxes == 1
        assert check(system, 1.0).ratio >= 0.99
    static = UncertainSystem([], np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((0, 0)), np.zeros((1, 0)), None, [[2.0]],
                             low=[], high=[], dt=1)  # fmt: skip
    for band in (0.0, 1.0):
        assert smallest_gain(static, band=band).bound == pytest.approx(2, rel=1e-9)


def test_a_parameter_of_zero_width_counts_with_its_value():
    system = random_uncertain_system(5, k=3)
    f = system.sample(0, 1)[0]
    low, high = system.low.copy(), system.high.copy()
    low[1] = high[1] = f[1]
    found = check(system.within(low, high), 0.3)
    assert found.values["f2"] == f[1]
    assert found.ratio >= 0.98


def test_defective_states_and_slow_poles():
    chain = 0.6 * np.eye(4) + np.diag(np.full(3, 0.3), 1)
    jordan = UncertainSystem(
        chain, np.eye(4)[:, -1:], np.ones((4, 1)), [[1, 0, 0, 0]], [[1, 0, 0, 0.5]], low=-0.01, high=0.01, dt=1
    )
    assert check(jordan, 0.5).ratio >= 0.99
    slow = UncertainSystem([[1 - 1e-6]], [[1]], [[1e-6]], [[1]], [[1]], low=-1e-7, high=1e-7, dt=1)
    for band in (0.0, 1e-6, 1.0):
        assert check(slow, band).ratio >= 0.98
    # However near to the boundary, 1 - A is exact, and so is the gain of the numbers that were given.
    slower = UncertainSystem([[1 - 1e-12]], [[1]], [[1]], [[1]], [[1]], low=-1e-13, high=1e-13, dt=1)
    found = smallest_gain(slower)
    exact = float(1 / (1 - Fraction(1 - 1e-12) + Fraction(1e-13)))
    assert found.attained == pytest.approx(exact, rel=1e-9)
    assert 0.99 * exact < found.bound <= exact


def engine_sensor(column: int) -> UncertainSystem:
    """Return the first residual of an estimator for the engine in closed loop, seen from one sensor's fault."""
    loop = jet_engine().in_closed_loop(jet_engine_controller())
    p = loop.nominal
    W = p.Bf.copy()
    W[:, 0] = np.concatenate([jet_engine_controller().B[:, 0], np.zeros(3)])
    P, n = np.array([[1.0, 0, 0]]), p.n_states
    Bf, Df = p.Bf[:, [column]], p.Df[:, [column]]
    zero = np.zeros((n, n))
    return UncertainSystem(
        np.block([[p.A, zero], [zero, p.A - W @ p.C]]),
        -np.vstack([loop.Hx, loop.Hx - W @ loop.Hy]),
        np.vstack([Bf, Bf - W @ Df]),
        np.hstack([loop.Gx, np.zeros_like(loop.Gx)]),
        np.hstack([np.zeros((1, n)), P @ p.C]),
        -P @ loop.Hy,
        P @ Df,
        low=loop.low - loop.nominal_values,
        high=loop.high - loop.nominal_values,
        channels=loop.channels,
        parameters=loop.names,
        dt=p.dt,
    )


@pytest.mark.parametrize("band", [0.0, 1.0, 50.0])
def test_jet_engine(band):
    system = engine_sensor(0)
    found = smallest_gain(system, band=band)
    assert found.ratio >= 0.99
    assert found.boxes <= 20
    points = np.vstack([system.sample(1, 300), system.vertices()[::7]])
    assert min(gain(system, f, band * i / len(points)) for i, f in enumerate(points)) >= found.bound
    # Ten times the set: a few boxes more.
    wide = smallest_gain(system.within(10 * system.low, 10 * system.high), band=band)
    assert wide.ratio >= 0.99
    assert wide.bound < found.bound


def test_more_parameters_than_corners_can_be_visited():
    system = random_uncertain_system(1, n=12, k=36)
    system = system.within(0.1 * system.low, 0.1 * system.high)
    for band in (0.0, 0.3):
        found = smallest_gain(system, band=band)
        assert found.ratio >= 0.99
        points = system.sample(3, 300)
        assert min(gain(system, f, band * i / 300) for i, f in enumerate(points)) >= found.bound


def test_a_bound_that_is_not_done_holds_and_says_so():
    system = random_uncertain_system(82)
    full = smallest_gain(system, band=0.5)
    assert full.note == ""
    bounds = []
    for boxes in (1, 30, 100):
        found = smallest_gain(system, band=0.5, most_boxes=boxes)
        assert found.boxes <= boxes
        assert f"after {found.boxes} boxes: raise most_boxes" in found.note
        bounds.append(found.bound)
    assert bounds[0] == 0.0 <= bounds[1] < bounds[2] < full.bound
    assert "no member has a pole in the band was not proved" in smallest_gain(system, band=0.5, most_boxes=1).note


def test_accuracy_is_a_setting():
    system = random_uncertain_system(5)
    coarse, fine = smallest_gain(system, band=0.3, rtol=0.2), smallest_gain(system, band=0.3, rtol=1e-3)
    assert coarse.boxes < fine.boxes
    assert coarse.ratio >= 0.8
    assert fine.ratio >= 0.999


def test_unstable_members_are_named():
    lag = {"A": [[0.5]], "Bp": [[1]], "Bw": [[1]], "Cq": [[1]], "Cz": [[1]], "parameters": ["pole"]}
    with pytest.raises(DesignError, match=r"not stable: pole 1\.\d* at pole = 0\."):
        smallest_gain(UncertainSystem(**lag, low=[0], high=[0.6], dt=1))
    with pytest.raises(DesignError, match=r"not stable: pole 1 at pole = 0\.5;"):  # at the frequency in question
        smallest_gain(UncertainSystem(**lag, low=[0.5], high=[0.5], dt=1))
    with pytest.raises(DesignError, match="not stable: pole"):
        smallest_gain(UncertainSystem(**lag, low=[0], high=[0.6]))
    integrator = UncertainSystem([[0]], np.zeros((1, 0)), [[1]], np.zeros((0, 1)), [[1]], low=[], high=[])
    with pytest.raises(DesignError, match="not stable: pole 0; its output"):
        smallest_gain(integrator)


def test_a_pole_that_only_inner_members_have_is_found():
    # Poles of [[1.0004, -f], [f, 0]]: one beyond 1 for |f| < 0.02 only, which is neither a corner nor the centre.
    system = UncertainSystem(
        [[1.0004, 0], [0, 0]], np.eye(2), [[1], [0]], [[0, -1], [1, 0]], [[1, 0]], low=-0.9, high=0.8,
        channels=[0, 0], dt=1,
    )  # fmt: skip
    radii = [np.abs(np.linalg.eigvals(system.member([f]).A)).max() for f in (-0.9, -0.05, 0.0, 0.8)]
    assert [r < 1 for r in radii] == [True, True, False, True]
    with pytest.raises(DesignError, match=r"not stable: pole 1.* at f1 = -?0\.0"):
        smallest_gain(system, samples=1)


def test_bad_requests():
    system = random_uncertain_system(4)
    with pytest.raises(ModelError, match="from faults to residuals, got StateSpace"):
        smallest_gain(StateSpace([[0.5]], [[1]], [[1]], dt=1))  # type: ignore[arg-type]
    without = UncertainSystem([[0.5]], [[1]], np.zeros((1, 0)), [[1]], [[1]], low=0, high=0.1, dt=1)
    with pytest.raises(ModelError, match="has no inputs"):
        smallest_gain(without)
    for band in (-1.0, np.nan, np.inf, "fast", True):
        with pytest.raises(SettingError, match="band must be a frequency"):
            smallest_gain(system, band=band)
    with pytest.raises(SettingError, match=r"band = 3.2 rad/s lies beyond pi / dt = 3.14159"):
        smallest_gain(system, band=3.2)
    for rtol in (0.0, 1.0, np.nan):
        with pytest.raises(SettingError, match=r"rtol must lie in \(0, 1\)"):
            smallest_gain(system, rtol=rtol)
    with pytest.raises(SettingError, match="at least 1"):
        smallest_gain(system, most_boxes=0)
    with pytest.raises(SettingError, match="at least 1"):
        smallest_gain(system, samples=0)


def test_the_same_request_has_the_same_answer():
    system = random_uncertain_system(10)
    first, second = (smallest_gain(system, band=0.5, seed=3) for _ in range(2))
    assert (first.bound, first.attained, first.values) == (second.bound, second.attained, second.values)


@pytest.mark.parametrize("size", [1.0, 1e9])
def test_two_inputs_by_way_of_one_state_leave_one_without_output(size):
    system = UncertainSystem(
        [[-0.9]],
        [[1.0]],
        np.array([[-1.013, 1.181]]) * size,
        [[0.1]],
        [[-0.263], [-3.257]],
        low=[-0.1],
        high=[0.1],
        dt=1,
    )
    found = smallest_gain(system)
    assert (found.bound, found.attained) == (0, 0)
    assert "zero" in found.note


@pytest.mark.parametrize("exponent", [20, 30, 41])
def test_a_gain_is_not_zero_where_poles_lie_near_one(exponent: int) -> None:
    """A slow lag, 1 - 2^-k at full sampling rate: 1 - A is exact, and so is the gain of two."""
    slow = 2.0**-exponent
    lag = UncertainSystem(
        [[1 - slow]], [[1.0]], [[2 * slow]], [[1.0]], [[1.0]], low=[-slow / 64], high=[slow / 64], dt=1.0
    )
    found = smallest_gain(lag)
    assert found.attained == pytest.approx(2 / (1 + 1 / 64), rel=1e-9)
    assert found.bound > 0.98 * found.attained
