"""What is asked of robust l1 banks: units, sizes and settings of any kind, resumed searches, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

import residua as rs
from residua.design import DifferentialEvolution, GeneticSearch
from residua.errors import DesignError, ModelError, NoCertificateError, SettingError
from residua.linear import StateSpace, smallest_gain
from residua.plant import Perturbation, UncertainPlant
from residua.robust.estimators import robust_estimator
from residua.robust.estimators.certified_threshold import certified_threshold
from residua.robust.estimators.estimator_family import estimator_family
from residua.robust.estimators.starting_gains import starting_gains
from residua.robust.sets.uncertain_loop import residual_over_set
from residua.robust.sets.uncertain_plant import make_uncertain_plant
from robust_loops import random_loop

QUICK = DifferentialEvolution(population=30, generations=15, polish=False)


def controlled_loop(seed: int = 0, units: np.ndarray | None = None, *, size: float = 0.02) -> UncertainPlant:
    """Return a small loop with a controller, whose states some faults do not reach; its four states in other units."""
    rng = np.random.default_rng(seed)
    A = np.diag(rng.uniform(0.3, 0.9, 2)) + 0.1 * rng.uniform(-1, 1, (2, 2)) * [[0, 1], [1, 0]]
    B = np.array([[0.1, 0], [0.02, 0.2]])
    plant = rs.Plant(A, B, np.eye(2), dt=0.1, outputs=["y1", "y2"])
    plant = plant.with_disturbances(np.diag([0.05, 0.03]), output=np.diag([0.02, 0.01])).with_sensor_faults()
    deltas = [
        Perturbation("A", [[1.0], [0]], [[1.0, 0]], -size, size, ["p"]),
        Perturbation("B", [[1.0], [0.5]], [[1.0, 0]], -size, size, ["p"]),
        Perturbation("C", [[1.0], [0.3]], [[1.0, 0]], -size, size, ["q"]),
    ]
    controller = StateSpace(np.diag([0.2, 0.3]), 0.5 * np.eye(2), -np.diag([0.6, 0.4]), dt=0.1)
    loop = UncertainPlant(plant, deltas).in_closed_loop(controller)
    u = np.ones(4) if units is None else units
    p = loop.nominal
    scaled = {name: getattr(p, name) * u[:, None] for name in ("B", "Bd", "Bf", "Bw")}
    p = p._with(A=p.A * u[:, None] / u, C=p.C / u, **scaled)
    G = np.hstack([loop.Gx / u, loop.Gu, loop.Gd, loop.Gf])
    return make_uncertain_plant(p, loop.parameters, loop.channels, np.vstack([loop.Hx * u[:, None], loop.Hy]), G)


def test_units_of_states_do_not_matter_to_what_a_fault_leaves():
    """The response of an estimator has the same bound, however many powers of ten lie between the states."""
    for seed in range(25):
        u = 10.0 ** np.random.default_rng(seed).uniform(-6, 6, 4)
        loop, other = controlled_loop(seed), controlled_loop(seed, u)
        family = estimator_family(loop.nominal, "y1 sensor", ("y2 sensor",))
        one, T = family.estimator(family.point(starting_gains(family, 0.92)[1], np.ones(1)))
        again = StateSpace(one.A * u[:, None] / u, one.B * u[:, None], one.C / u, one.D, dt=one.dt)
        plain = smallest_gain(residual_over_set(loop, one, T, signals=["y1 sensor"]))
        found = smallest_gain(residual_over_set(other, again, T, signals=["y1 sensor"]))
        assert plain.ratio > 0.98
        assert found.bound == pytest.approx(plain.bound, rel=1e-5)
        assert found.attained == pytest.approx(plain.attained, rel=1e-5)


@pytest.mark.parametrize("u", [(1e6, 1e6, 1e-6, 1e6), (1e6, 1e-6, 1e-6, 1e-6), (1e-4, 1e6, 1e2, 1e-6)])
@pytest.mark.parametrize("actuator", [False, True])
def test_units_of_states_do_not_matter_to_a_bank(u, actuator):
    found = []
    for units in (np.ones(4), np.array(u)):
        loop = controlled_loop(0, units)
        if actuator:  # divided out, where the sensors alone are not
            plant = loop.nominal.with_faults({"valve": units * [0.1, 0.02, 0, 0]}, kind="actuator")
            H, G = np.vstack([loop.Hx, loop.Hy]), np.hstack([loop.Gx, loop.Gu, loop.Gd, np.zeros((len(loop.Gf), 3))])
            loop = make_uncertain_plant(plant, loop.parameters, loop.channels, H, G)
        ignored = ["valve"] if actuator else ["y2 sensor"]
        bank = rs.design.robust_l1_bank(
            loop, ["y1 sensor"], decouple=ignored, search=QUICK, method="star", progress=False
        )
        found.append(bank.smallest_faults)
    assert found[1]["y1 sensor"] == pytest.approx(found[0]["y1 sensor"], rel=0.05)  # where the searches have got to


def test_large_sizes_of_other_faults():
    """The floor of the smallest fault grows with what leaks; nothing is refused for being dear."""
    loop, found = controlled_loop(), []
    for size in (1e5, 1e9):
        bank = rs.design.robust_l1_bank(
            loop, ["y1 sensor"], sizes={"y2 sensor": size}, search=QUICK, method="centred", progress=False
        )
        found.append(bank.smallest_faults["y1 sensor"] / size)
    assert found[1] == pytest.approx(found[0], rel=0.05)


def test_unstable_members_are_named_before_anything_is_searched():
    """Stable at the corners and not in the middle; the message has parameters, not their deviations."""
    plant = rs.Plant([[1.0004, 0.9], [-0.9, 0]], [[], []], np.eye(2), dt=1.0)
    plant = plant.with_disturbances(0.1 * np.eye(2)).with_sensor_faults()
    loop = UncertainPlant(
        plant, deltas=[Perturbation("A", np.eye(2), [[0, 1.0], [-1.0, 0]], [0.0] * 2, [1.8] * 2, ["f", "f"])]
    )
    radii = [np.abs(np.linalg.eigvals(loop.member([f]).A)).max() for f in (0.0, 0.5, 0.9, 1.8)]
    assert [r < 1 for r in radii] == [True, True, False, True]
    with pytest.raises(DesignError, match=r"not stable: pole 1\S* at f = 0\.(89|9)"):
        rs.design.robust_l1_bank(loop, search=QUICK, progress=False)


def test_settling_within_less_than_a_sample_is_refused():
    with pytest.raises(SettingError, match=r"shorter than one sample, 0\.1 s"):
        rs.design.robust_l1_bank(controlled_loop(), settling=1e-9, progress=False)


@pytest.mark.parametrize("seed", [2, 3])
def test_longer_search_goes_on_from_the_files_of_a_shorter_one(tmp_path, seed):
    """Both have rounds with further members, whose starts are what the first round has found."""
    loop = random_loop(seed)
    name, options = loop.nominal.faults[0], {"method": "star", "progress": False}

    def designed(generations, folder):
        search = GeneticSearch(population=24, generations=generations, polish=False)
        return rs.design.robust_l1_bank(loop, [name], search=search, checkpoint=folder, **options).estimators[name]

    designed(3, tmp_path / "one")
    before = set((tmp_path / "one").iterdir())
    longer, fresh = designed(10, tmp_path / "one"), designed(10, tmp_path / "two")
    assert np.array_equal(longer.filter.B, fresh.filter.B)
    assert longer.cost == fresh.cost
    after = {path.name for path in (tmp_path / "one").iterdir()}
    assert {path.name for path in (tmp_path / "two").iterdir()} <= after  # the first stage went on
    assert after >= {path.name for path in before}
    # another loop in the same folder begins its own files
    rs.design.robust_l1_bank(
        random_loop(seed + 1),
        search=GeneticSearch(population=24, generations=2),
        checkpoint=tmp_path / "one",
        **options,
    )


def test_a_checkpoint_that_is_a_file_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(SettingError, match="must be a folder"):
            rs.design.robust_l1_bank(controlled_loop(), search="genetic", checkpoint=path, progress=False)


def integrating(extra: bool) -> UncertainPlant:
    """Return a tank whose level is held by integral action, with or without its command as an output."""
    D = [[0.0], [1.0]] if extra else [[0.0]]
    tank = rs.Plant([[0.9]], [[0.1]], [[1.0], [0.0]] if extra else [[1.0]], D, dt=1.0)
    tank = tank.with_disturbances([[0.1]], output=[[0.01], [0.0]] if extra else [[0.01]])
    tank = tank.with_faults({"level": ([0.0], [1.0, 0.0] if extra else [1.0])}, kind="sensor")
    controller = StateSpace([[1.0]], [[0.05, 0.0] if extra else [0.05]], [[-1.0]], dt=1.0)
    return UncertainPlant(tank, deltas=[Perturbation("A", [[1.0]], [[1.0]], -0.01, 0.01, ["a"])]).in_closed_loop(
        controller
    )


def test_faults_that_integral_action_hides_are_refused_before_any_search():
    told = []
    with pytest.raises(DesignError, match=r"steady response to it is zero. Integral action .* further outputs"):
        rs.design.robust_l1_bank(integrating(False), progress=lambda *stage: told.append(stage))
    assert not told
    rs.design.robust_l1_bank(integrating(True), search=QUICK, method="star", progress=False)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("beta", [0.0, 1.0])
def test_weights_at_their_ends(beta):
    bank = rs.design.robust_l1_bank(
        controlled_loop(), ["y1 sensor"], beta=beta, search=QUICK, method="star", progress=False
    )
    assert bank.estimators["y1 sensor"].sensitivity.bound == pytest.approx(1, rel=0.02)


def test_what_is_told():
    loop = controlled_loop()
    bank = rs.design.robust_l1_bank(
        loop, ["y1 sensor", "y1 sensor"], sizes={"y2 sensor": 2.0}, search=QUICK, method="centred", progress=False
    )
    assert bank.members == ("y1 sensor",)  # named twice, meant once
    assert "y1 sensor: of other faults a unit adds at most: y2 sensor " in str(bank)
    assert "(covered to 2)" in str(bank)
    values = bank.estimators["y1 sensor"].sensitivity.values
    loop.member(values)  # parameters of the loop, not deviations


@pytest.mark.parametrize("given", [None, 40.0])
def test_faster_estimators_where_no_threshold_is_certified(monkeypatch, given):
    """What cannot be certified within the default time is tried within half of it, and said; never with a given one."""
    plant = rs.Plant([[0.995]], [[]], [[1.0]], dt=0.1, outputs=["y1"]).with_disturbances([[0.1]], output=[[0.01]])
    loop = UncertainPlant(plant.with_sensor_faults(), [Perturbation("A", [[1.0]], [[1.0]], -0.001, 0.001, ["a"])])
    seen = []

    def slow_ones_fail(*args, **options):
        seen.append(np.abs(args[1].poles()).max())
        if len(seen) < 3:
            raise NoCertificateError("method 'star' found no certificate: cut it into parts with boxes=4")
        return certified_threshold(*args, **options)

    monkeypatch.setattr(robust_estimator, "certified_threshold", slow_ones_fail)
    options = {"search": QUICK, "method": "star", "settling": given, "progress": False}
    if given is not None:
        with pytest.raises(
            DesignError, match=r"within 40 s \(method 'star' found no certificate\).*settling="
        ) as caught:
            rs.design.robust_l1_bank(loop, **options)
        assert "boxes" not in str(caught.value)
        return
    bank = rs.design.robust_l1_bank(loop, **options)
    assert len(seen) == 3
    assert seen[2] <= 0.995
    (note,) = (note for note in bank.generator.evidence.notes if "settles in" in note)
    assert "settles in 19.5 s: no threshold was certified for one that may take 78 s, the default" in note


def test_wrong_settings_are_refused():
    loop = random_loop(1)
    for wrong in (loop.nominal, None):
        with pytest.raises(ModelError, match=r"must be an UncertainPlant, got .*make one"):
            rs.design.robust_l1_bank(wrong)
    with pytest.raises(SettingError, match="faults= is empty"):
        rs.design.robust_l1_bank(loop, [])
    open_plant = UncertainPlant(
        rs.Plant([[0.5]], [[1.0]], [[1.0]], dt=1.0).with_disturbances([[1.0]]).with_sensor_faults()
    )
    with pytest.raises(ModelError, match="in_closed_loop"):
        rs.design.robust_l1_bank(open_plant)
    continuous = UncertainPlant(rs.Plant([[-1.0]], [[]], [[1.0]]).with_disturbances([[1.0]]).with_sensor_faults())
    with pytest.raises(ModelError, match="discretize"):
        rs.design.robust_l1_bank(continuous)
    none = UncertainPlant(rs.Plant([[0.5]], [[]], [[1.0]], dt=1.0).with_disturbances([[1.0]]))
    with pytest.raises(DesignError, match="no faults"):
        rs.design.robust_l1_bank(none)
    unstable = UncertainPlant(rs.Plant([[1.5]], [[]], [[1.0]], dt=1.0).with_disturbances([[1.0]]).with_sensor_faults())
    with pytest.raises(DesignError, match="not stable"):
        rs.design.robust_l1_bank(unstable)
    for wrong in (
        {"beta": 1.5},
        {"gamma": -1},
        {"beta": 1.0, "gamma": 0.0},
        {"band": -1},
        {"band": 1e3},
        {"settling": 0.0},
        {"search": "annealing"},
        {"sizes": {"sensor 1": -1.0}},
        {"checkpoint": "folder"},
        {"method": "exact"},
    ):
        with pytest.raises(SettingError):
            rs.design.robust_l1_bank(loop, **wrong)
    with pytest.raises(ModelError, match="no disturbances"):
        rs.design.robust_l1_bank(
            UncertainPlant(rs.Plant([[0.5]], [[]], [[1.0]], dt=1.0).with_sensor_faults()), progress=False
        )
