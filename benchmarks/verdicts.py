"""Count how often the word of a verdict is right, on plants and recordings that set none of its thresholds.

Run it with::

    .venv/bin/python benchmarks/verdicts.py --out docs/data/verdicts.csv

Each recording has one known cause: a listed fault, a course that no fault of the list has, a fault that the monitor was
not told of, two faults, a fault that is there from the first sample, none, a plant that changed, more noise, a spike,
or other units. The first alarm that lasts into it has a word by the samples up to 50 and 200 after it was raised, and
before there was a rule of words it had one by scores, of the whole alarm. A name is wrong if the cause is not in it;
"either this or something not listed" is also right where the cause is not listed. "Poor match" and "too early" are
never wrong, but name nothing. A recording without an alarm has no verdict.

The table has, for each model of the monitor, time and cause, the number of verdicts and of these the percentages with
each word and with a wrong one. "Mix" weighs causes by ``MIX``. Kalman filters with the default test are fitted to
20,000 rows; their models are the plant itself and one whose dynamics are off by 5 %. A size of 1 is what a norm over 10
samples just sees of a step. ``--quick 20`` is a part of it.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, cast

import numpy as np
from default_faults import HEALTHY, LEAD, ROWS, Simulated, plants
from numpy.typing import NDArray

import residua as rs
from residua.monitor import Alarm, Diagnosis

#: Share of each cause among all verdicts, as the summary weighs them.
MIX = {
    "listed": 0.55, "other course": 0.10, "left out": 0.08, "two at once": 0.05, "first sample": 0.05,
    "no fault": 0.05, "plant changed": 0.04, "noise": 0.03, "spike": 0.03, "units": 0.02,
}  # fmt: skip
#: Share of each cause among the recordings: the rare ones are simulated more often than they count.
DRAWN = {
    "listed": 0.36, "other course": 0.11, "left out": 0.11, "two at once": 0.07, "first sample": 0.04,
    "no fault": 0.12, "plant changed": 0.06, "noise": 0.04, "spike": 0.04, "units": 0.05,
}  # fmt: skip
#: Recordings of one plant and model, rows of a recording after the healthy ones, and of one without a fault.
RECORDINGS, FAULTY, QUIET = 400, 500, 5000
SIZES = (1.2, 2.5, 6, 20)
#: Causes that are there from the first sample, or never.
THROUGHOUT = ("first sample", "plant changed", "no fault")
#: Samples after an alarm at which a word is asked for.
TIMES = (50, 200)
#: Groups of faults that a monitor is not told of, one at a time.
LEFT_OUT = 3
#: Step responses with a larger cosine are those of one fault; samples that it is taken over.
SAME, COMPARED = 0.9995, 200
#: By score, before there was a rule of words: leads that were clear and moderate, and the least score of a match.
CLEAR, CLOSE, POOR = 0.10, 0.02, 0.70
MODELS = {"given": 0.0, "5 % off": 0.05}
WORDS = ("good match", "either", "poor match", "too early")
HEADER = ("model", "words", "truth", "n", "good", "good wrong", "either", "either wrong", "poor", "early")


def quadruple_tank() -> rs.Plant:
    """Return four tanks that two pumps fill crosswise (Johansson, 2000): volts and centimetres."""
    area, seconds = np.array([28.0, 32.0, 28.0, 32.0]), np.array([62.0, 90.0, 23.0, 30.0])
    A = np.diag(-1 / seconds)
    A[0, 2], A[1, 3] = area[2] / area[0] / seconds[2], area[3] / area[1] / seconds[3]
    to_lower, per_volt = (0.70, 0.60), (3.33, 3.35)
    B = np.zeros((4, 2))
    for pump, (lower, upper) in enumerate(((0, 3), (1, 2))):
        B[lower, pump] = to_lower[pump] * per_volt[pump] / area[lower]
        B[upper, pump] = (1 - to_lower[pump]) * per_volt[pump] / area[upper]
    levels = ["h1", "h2", "h3", "h4"]
    plant = rs.Plant(A, B, np.eye(4), name="quadruple tank", inputs=["pump 1", "pump 2"], outputs=levels)
    plant = plant.with_faults({"leak 1": [-1 / 28, 0, 0, 0], "leak 4": [0, 0, 0, -1 / 32]})
    plant = plant.with_faults({"valve 1": [3.33 / 28, 0, 0, -3.33 / 32], "clog 31": [-1 / 28, 0, 1 / 28, 0]})
    return plant.discretize(2.0).with_noise(process=1e-5, measurement=2.5e-3)


def drive() -> rs.Plant:
    """Return a motor that turns a load by a flexible shaft: newton metres, radians a second, twist."""
    motor, load, stiffness, damping, friction = 0.02, 0.05, 20.0, 0.05, 0.03
    A = [
        [-(friction + damping) / motor, damping / motor, -stiffness / motor],
        [damping / load, -(friction + damping) / load, stiffness / load],
        [1, -1, 0],
    ]
    outputs = ["motor speed", "load speed"]
    C = [[1, 0, 0], [0, 1, 0]]
    plant = rs.Plant(A, [[1 / motor], [0], [0]], C, name="two-mass drive", inputs=["torque"], outputs=outputs)
    plant = plant.with_faults({"load torque": [0, -1 / load, 0]})
    return plant.discretize(0.005).with_noise(process=[1e-4, 1e-4, 1e-9], measurement=0.01)


def heated_tanks() -> rs.Plant:
    """Return three stirred tanks in series, the first and the last heated: kilowatts and kelvin."""
    volume, flow, heat = 50.0, 0.5, 4.19  # litres, litres a second, kilojoules per litre and kelvin
    A = (np.diag([-1.0, -1.0, -1.0]) + np.diag([1.0, 1.0], -1)) * flow / volume
    B = np.array([[1, 0], [0, 0], [0, 1]]) / (volume * heat)
    outputs = ["T1", "T2", "T3"]
    plant = rs.Plant(A, B, np.eye(3), name="heaters in series", inputs=["P1", "P3"], outputs=outputs)
    plant = plant.with_faults({"inlet": [flow / volume, 0, 0], "loss 2": [0, -flow / volume, 0]})
    return plant.discretize(5.0).with_noise(process=1e-6, measurement=4e-4)


def vehicle() -> rs.Plant:
    """Return a car at 20 m/s that is steered, by sideslip and yaw: degrees, metres and seconds."""
    mass, inertia, front, rear, stiff_front, stiff_rear, speed = 1500.0, 2500.0, 1.1, 1.6, 8e4, 9e4, 20.0
    turn, slip = rear * stiff_rear - front * stiff_front, stiff_front + stiff_rear
    spring = front**2 * stiff_front + rear**2 * stiff_rear
    degree = np.pi / 180
    A = np.array(
        [
            [-slip / (mass * speed), (turn / (mass * speed) - speed) * degree],
            [turn / (inertia * speed) / degree, -spring / (inertia * speed)],
        ]
    )
    B = np.array([[stiff_front / mass * degree], [front * stiff_front / inertia]])
    outputs = ["slip speed", "yaw rate", "acceleration"]
    C, D = [[1, 0], [0, 1], A[0] + [0, speed * degree]], [[0], [0], B[0]]
    plant = rs.Plant(A, B, C, np.array(D, dtype=float), name="lateral vehicle", inputs=["steering"], outputs=outputs)
    plant = plant.with_faults({"side wind": ([1, 0], [0, 0, 1]), "pull of a brake": [0, 1]})
    return plant.discretize(0.02).with_noise(process=[1e-6, 1e-4], measurement=[4e-4, 4e-2, 2.5e-3])


def all_plants() -> Iterator[rs.Plant]:
    """Yield the plants of ``default_faults``, then four others."""
    yield from plants()
    for plant in (quadruple_tank(), drive(), heated_tanks(), vehicle()):
        yield plant.with_actuator_faults().with_sensor_faults()


def off(A: NDArray, by: float, rng: np.random.Generator, count: int) -> NDArray:
    """Return dynamics with entries off by a share, normal, of the bilinear transform, which is nearly that in time."""
    one = np.eye(len(A))
    slow = np.linalg.solve(A + one, A - one) * (1 + by * rng.standard_normal((count, *A.shape)))
    return np.linalg.solve(one - slow, one + slow)


@dataclass(frozen=True, eq=False)
class Subject:
    """A plant with a model of it that is watched, and what each fault moves.

    Attributes
    ----------
    simulated : Simulated
    model : Plant
    healthy : pair of ndarray
        Inputs and outputs that monitors are fitted to.
    sizes : mapping of str to float
        Of each fault that is seen: a step of that size is just seen by a norm over 10 samples.
    alike : mapping of str to frozenset of str
        The faults that look the same, itself among them.
    """

    simulated: Simulated
    model: rs.Plant
    healthy: tuple[NDArray, NDArray]
    sizes: Mapping[str, float]
    alike: Mapping[str, frozenset[str]]

    @classmethod
    def of(cls, plant: rs.Plant, by: float, rng: np.random.Generator) -> Subject:
        """Return a plant with a model whose dynamics are off by a share."""
        simulated = Simulated(plant)
        model = plant._with(A=off(plant.A, by, rng, 1)[0])
        healthy = simulated.undisturbed(rng, ROWS)
        norm = rs.Monitor(rs.design.kalman_filter(model), test=rs.decide.NormThreshold(window=10), isolate=None)
        norm.fit(*healthy)
        scale = np.array([1000 * simulated.sigma(fault) for fault in plant.faults])
        f = np.zeros((len(scale), HEALTHY + COMPARED, len(scale)))
        f[:, HEALTHY:] = np.diag(scale)[:, None]
        rest = np.zeros((*f.shape[:2], len(plant.inputs))), np.zeros((*f.shape[:2], plant.Bw.shape[1]))
        found = cast(list[Diagnosis], norm.run(*simulated.respond(*rest, f)))
        peaks = np.array([np.nanmax(one.statistic) for one in found]) / norm.threshold
        white = np.array([((one.residuals - one.test.center) @ one.test.whitening)[HEALTHY:].ravel() for one in found])
        white /= np.linalg.norm(white, axis=1, keepdims=True) + np.finfo(float).tiny
        same = np.abs(white @ white.T) > SAME
        seen = [k for k in range(len(scale)) if peaks[k] > 1]
        return cls(
            simulated,
            model,
            healthy,
            {plant.faults[k]: scale[k] / peaks[k] for k in seen},
            {plant.faults[k]: frozenset(plant.faults[j] for j in seen if same[j, k]) for k in seen},
        )

    def monitor(self, without: Sequence[str] = ()) -> rs.Monitor:
        """Return a fitted monitor that is not told of some faults."""
        made = rs.Monitor(rs.design.kalman_filter(self.model.without_faults(without)))
        return made.fit(*self.healthy)

    def recordings(
        self, cause: str, count: int, rng: np.random.Generator, among: Sequence[str] = ()
    ) -> tuple[NDArray, NDArray, list[frozenset[str]]]:
        """Return inputs, outputs and the listed faults that are there, of some recordings with a cause.

        Faults are drawn among some; among all that are seen when omitted.
        """
        plant = self.simulated.plant
        rows = QUIET if cause == "no fault" else HEALTHY + FAULTY
        begins = LEAD + (0 if cause in THROUGHOUT else HEALTHY)
        r, w = self.simulated.signals(rng, count, LEAD + rows)
        f = np.zeros((count, LEAD + rows, len(plant.faults)))
        truths = [frozenset[str]()] * count
        if cause in ("listed", "left out", "two at once", "first sample"):
            for k in range(count):
                names = self._drawn(rng, 2 if cause == "two at once" else 1, among or tuple(self.sizes))
                for name in names:
                    course = courses(FAULTY)[rng.integers(3)] if cause in ("listed", "left out") else np.ones(1)
                    size = rng.choice([-1, 1]) * rng.choice(SIZES) * self.sizes[name]
                    f[k, begins:, plant.faults.index(name)] = size * course
                truths[k] = frozenset() if cause == "left out" else frozenset(names)
        u, y = self.simulated.respond(r, w, f, self._changed(rng, count) if cause == "plant changed" else None)
        u, y = u[:, LEAD:], y[:, LEAD:]
        if cause in ("other course", "noise", "spike", "units"):
            truths = [self._alter(cause, u[k], y[k], rng) for k in range(count)]
        return u, y, truths

    def _drawn(self, rng: np.random.Generator, count: int, among: Sequence[str]) -> list[str]:
        """Return one fault, or two that do not look the same."""
        first = str(rng.choice(among))
        others = [name for name in among if name not in self.alike[first]]
        return [first] if count == 1 else [first, str(rng.choice(others))]

    def _changed(self, rng: np.random.Generator, count: int) -> NDArray:
        """Return dynamics that are off by 10 or 30 %, stable with the inner loop."""
        plant, changed = self.simulated.plant, []
        while len(changed) < count:
            A = off(plant.A, rng.choice([0.1, 0.3]), rng, 1)[0]
            if np.abs(np.linalg.eigvals(A - plant.B @ self.simulated.gain())).max() < 1:
                changed.append(A)
        return np.array(changed)

    def _alter(self, cause: str, u: NDArray, y: NDArray, rng: np.random.Generator) -> frozenset[str]:
        """Change recorded signals behind the healthy rows, in place; return the listed fault that this is."""
        plant = self.simulated.plant
        deviation = np.sqrt(np.diag(plant.Dw @ plant.Dw.T))
        after, output = slice(HEALTHY, None), int(rng.integers(plant.n_outputs))
        if cause == "units":
            factor = rng.choice([0.1, 10])
            u[after] *= factor
            y[after] *= factor
        elif cause == "spike":
            y[HEALTHY, output] += rng.choice([-1, 1]) * rng.choice([10, 30, 100]) * deviation[output]
        elif cause == "noise":
            grown = np.linspace(1, rng.choice([2, 4]), len(y) - HEALTHY)[:, None]
            some = np.arange(plant.n_outputs) == output if rng.random() < 0.5 else np.ones(plant.n_outputs)
            y[after] += np.sqrt(grown**2 - 1) * some * deviation * rng.standard_normal((len(grown), plant.n_outputs))
        else:
            channels = {**dict.fromkeys(plant.inputs, u), **dict.fromkeys(plant.outputs, y)}
            course = rng.choice(["stuck", "gain 1.1", "gain 2", "unit"])
            kinds = ("sensor", "actuator") if course == "unit" else ("sensor",)
            listed = [one for one in plant.fault_list if one.kind in kinds and one.name in self.sizes]
            fault = listed[rng.integers(len(listed))]
            names = plant.inputs if fault.component in plant.inputs else plant.outputs
            signal = channels[fault.component][after, names.index(fault.component)]
            signal[:] = signal[0] if course == "stuck" else signal * {"gain 1.1": 1.1, "gain 2": 2, "unit": 10}[course]
            return frozenset([fault.name])
        return frozenset()


def courses(rows: int) -> tuple[NDArray, NDArray, NDArray]:
    """Return a step, a ramp over 200 samples and what is there for 40 of 100 samples, all of size 1."""
    time = np.arange(rows)
    return np.ones(rows), np.minimum((time + 1) / 200, 1.0), (time % 100 < 40).astype(float)


class Said(NamedTuple):
    """A verdict: its word, the groups of faults that it names, and what is not listed beside them."""

    kind: str
    faults: tuple[tuple[str, ...], ...]
    unlisted: str = ""


def said_by_score(found: Diagnosis, alarm: Alarm) -> Said:
    """Return the word of a whole alarm by its scores, as it was before there was a rule of words."""
    over = np.flatnonzero(found.statistic[alarm.start : alarm.stop] > found.threshold)
    candidates = found.isolation.candidates(found.scores[alarm.start + int(over[-1])])  # a word puts its own first
    names = tuple(candidate.faults for candidate in candidates)
    scores = [candidate.score for candidate in candidates]
    if alarm.samples < found.naming.window or not names:
        return Said("too early", names[:1])
    if scores[0] < POOR:
        return Said("poor match", names[:1])
    if len(names) == 1 or scores[0] - scores[1] >= CLOSE:
        return Said("good match", names[:1])
    return Said("either", names[:2])


def is_wrong(said: Said, truth: frozenset[str]) -> bool:
    """Return whether a verdict names faults of which none is there."""
    if said.kind not in WORDS[:2]:
        return False
    if not truth:
        return said.kind == "good match" or not said.unlisted
    return not any(truth & set(group) for group in said.faults)


def verdicts(found: Diagnosis, cause: str) -> Iterator[tuple[str, Said]]:
    """Yield each time and its word: of the first alarm that lasts into what begins, without a fault of all alarms."""
    begins = 0 if cause in THROUGHOUT else HEALTHY
    alarms = [one for one in found.alarms if one.stop > begins]
    for alarm in alarms if cause == "no fault" else alarms[:1]:
        yield "before", said_by_score(found, alarm)
        for after in TIMES:
            word = found.word(alarm, after=after)
            yield f"after {after}", Said(word.kind, word.faults, word.unlisted)


def watched(
    subject: Subject, recordings: int, rng: np.random.Generator
) -> Iterator[tuple[str, frozenset[str], Diagnosis]]:
    """Yield the cause, the listed faults that are there, and what a monitor finds, of every recording."""
    monitor, groups = subject.monitor(), sorted({tuple(sorted(group)) for group in subject.alike.values()})
    for cause, share in DRAWN.items():
        count, monitors = max(1, round(share * recordings)), {(): monitor}
        if cause == "left out":
            some = [groups[k] for k in rng.permutation(len(groups))[:LEFT_OUT]]
            monitors = {group: subject.monitor(group) for group in some}
        for group, one in monitors.items():
            u, y, truths = subject.recordings(cause, -(-count // len(monitors)), rng, group)
            for found, truth in zip(cast(list[Diagnosis], one.run(u, y)), truths, strict=True):
                yield cause, truth, found


def counted(wanted: Sequence[str], seed: int, recordings: int) -> dict[tuple[str, str, str], NDArray]:
    """Return how often each word was said, and wrong, by model, time and cause: shape (2, words)."""
    counts: dict[tuple[str, str, str], NDArray] = {}
    for number, plant in enumerate(all_plants()):
        if wanted and plant.name not in wanted:
            continue
        for model, by in MODELS.items():
            rng = np.random.default_rng([seed, number, list(MODELS).index(model)])
            for cause, truth, found in watched(Subject.of(plant, by, rng), recordings, rng):
                for when, said in verdicts(found, cause):
                    wrong = is_wrong(said, truth)
                    count = counts.setdefault((model, when, cause), np.zeros((2, len(WORDS)), dtype=int))
                    count[:, WORDS.index(said.kind)] += 1, wrong
                    if wrong and when != "before":
                        print(f"{plant.name}, {model}: {cause} {sorted(truth)}: {when} {said}", flush=True)
    return counts


def table(counts: Mapping[tuple[str, str, str], NDArray]) -> Iterator[tuple[object, ...]]:
    """Yield the rows: percentages of the verdicts on each cause, then of the mix."""
    for model in ("both", *MODELS):
        for when in ("before", *(f"after {after}" for after in TIMES)):
            total, mixed, weight = 0, np.zeros(6), 0.0
            for cause, share in MIX.items():
                models = MODELS if model == "both" else (model,)
                parts = [counts[one, when, cause] for one in models if (one, when, cause) in counts]
                if not parts:
                    continue
                said, wrong = np.sum(parts, axis=0)
                n = int(said.sum())
                percent = 100 * np.array([said[0], wrong[0], said[1], wrong[1], said[2], said[3]]) / n
                yield model, when, cause, n, *(f"{one:.2f}" for one in percent)
                total, mixed, weight = total + n, mixed + share * percent, weight + share
            if weight:
                yield model, when, "mix", total, *(f"{one:.3f}" for one in mixed / weight)


def shares(rows: Sequence[Sequence[object]], model: str, when: str) -> dict[str, float]:
    """Return what is promised of the words, in percent: see the keys."""
    row = {str(row[2]): [float(str(one)) for one in row[4:]] for row in rows if tuple(row[:2]) == (model, when)}
    good, good_wrong, either, either_wrong, *_ = row["mix"]
    return {
        "good matches wrong": 100 * good_wrong / good if good else 0.0,
        "verdicts with a wrong good match": good_wrong,
        "eithers wrong": 100 * either_wrong / either if either else 0.0,
        "verdicts with a wrong either": either_wrong,
        "listed faults with a good match": row["listed"][0] if "listed" in row else 0.0,
    }


def summary(rows: Sequence[Sequence[object]]) -> Iterator[str]:
    """Yield what was asked for, in words."""
    for model, when in dict.fromkeys((str(row[0]), str(row[1])) for row in rows):
        said = ", ".join(f"{name} {share:.2f} %" for name, share in shares(rows, model, when).items())
        yield f"{model}, {when}: {said}"


def main() -> None:
    """Print the table, and write it where that is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plant", nargs="*", default=[])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--quick", type=int, default=RECORDINGS, metavar="N", help="recordings of each plant and model")
    parser.add_argument("--out", type=Path)
    asked = parser.parse_args()
    rows = list(table(counted(asked.plant, asked.seed, asked.quick)))
    for row in (HEADER, *rows):
        print(*row, sep="\t")
    print(*summary(rows), sep="\n")
    if asked.out is not None:
        with asked.out.open("w", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows([HEADER, *rows])


if __name__ == "__main__":
    sys.exit(main())
