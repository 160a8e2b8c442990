"""
Three tanks: eleven faults in recordings that others made
=========================================================

Three tanks in a row are joined by pipes; two pumps fill the outer ones, and two controllers hold their levels. The
controllers make diagnosis hard: they hide a leak by pumping more. For this benchmark, the Amira DTS200, others have
published recordings with known faults. Here the package gets a linear model and one fault-free recording, and has to
name the faulty component in eleven others.

Everything on this page is computed when the page is built. The recordings state no licence and are not part of the
package; where they are absent, the same faults are simulated with the benchmark's nonlinear model, and the first line
of output says which of the two it was.
"""

import os
import textwrap
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import scipy.io

import residua as rs
from residua.library import simulate_three_tank, three_tank, three_tank_fault
from residua.library.three_tank import LEVELS, pipe_flows
from residua.report.plots import plot_diagnosis, plot_directions

# %%
# Recordings
# ----------
# Five columns at one sample per second: commanded pump flows Q1 and Q2 in cm³/s, measured levels h1, h2 and h3 in cm.
# In every test the fault begins at 200 s and grows slowly. Fault 1, which disturbs both pumps at once, is left out: this
# monitor looks for one faulty component.
folder = Path(os.environ.get("RESIDUA_SHARED_DATA", "../../../shared/data")) / "three_tank_dts200"
ONSET, FAULTS = 200, range(2, 13)


def split(block):
    """Return inputs and outputs of one recording."""
    return block[:, :2], block[:, 2:]


def simulated(steps, seed, faults=None):
    run = simulate_three_tank(steps, faults=faults, seed=seed)
    return run.u, run.y


if (folder / "test_5ch.mat").is_file():
    print("Data: the benchmark's recordings, train_5ch.mat and test_5ch.mat.")
    normal = split(scipy.io.loadmat(folder / "train_5ch.mat")["normal"])
    tests = scipy.io.loadmat(folder / "test_5ch.mat")
    faulty = {number: split(tests[f"fault{number:02d}"]) for number in FAULTS}
else:
    print("Data: SIMULATED with the benchmark's nonlinear model; the recordings are not on this machine.")
    normal = simulated(16008, seed=100)
    faulty = {number: simulated(2001, number, three_tank_fault(number, onset=ONSET)) for number in FAULTS}

really = {number: next(iter(three_tank_fault(number))) for number in FAULTS}
half = len(normal[1]) // 2
print(f"{len(normal[1])} fault-free samples, {len(faulty)} recordings with a fault from {ONSET} s on")

# %%
# What can be told apart at all
# -----------------------------
# Before any data are looked at: the linear model, with everything that may break, says which faults no method whatever
# can tell apart. A pump that delivers too little and a leak in its tank are the same to the level sensors.
plant = three_tank(dt=1.0)
print(rs.diagnosability(plant))

# %%
# The last two lines matter below. A constant offset of the sensor of h1 and a constant clogged pipe 1-3 leave the same
# lasting trace. Only their changes differ, and the faults of this benchmark change slowly.
#
# The monitor
# -----------
# A Kalman filter with the noise that the benchmark publishes: variance 0.02 cm² on each reading, 1e-4 cm² per second on
# each level. (The benchmark's pump noise would add 2 % to the latter and is left out.) Its innovations are the
# residuals, and each fault has the direction in which a constant fault moves them. Threshold, mean and covariance are
# fitted on the first half of the fault-free recording; the second half tells how many false alarms that gives. The test
# is the one that a monitor has without an option, and so is the rate: what 8000 samples can carry.
kalman = rs.design.kalman_filter(plant)


def monitor_for(generator, test=None):
    """Return a monitor fitted on the first half of the fault-free recording."""
    monitor = rs.Monitor(generator, test=test, isolate=rs.decide.Directional(window=300))  # directions over 300 s
    return monitor.fit(normal[0][:half], normal[1][:half])


monitor = monitor_for(kalman)
second_half = monitor.run(normal[0][half:], normal[1][half:])
print(monitor)
print(textwrap.fill(f"threshold: {monitor.norm_test.basis}", 110))
print(f"second half: {second_half.false_alarm_fraction:.2%} of {second_half.decided.sum()} samples in alarm")
assert second_half.false_alarm_fraction <= 0.01

# %%
# Eleven faults
# -------------
# For each recording: how long after its beginning the fault raised an alarm, with the test above and, for comparison, with
# single samples, three in a row over a threshold; and which group of faults scores best over the last 300 samples. The score is
# the cosine of the angle between the averaged residual and the group's direction. The margin is the lead of the right group
# over the best other one: negative where a wrong group is in front. The word is that of the diagnosis: how well the faults, with any
# course, explain what the residual has beyond noise. No wrong name is a *good match*.
single = monitor_for(kalman, test=rs.decide.NormThreshold())
diagnoses = {number: monitor.run(*recording, source=f"fault {number}") for number, recording in faulty.items()}


def verdict(diagnosis, fault):
    """Return the best group at the end, its score, the margin of the right group, and the closest rival."""
    final = diagnosis.scores[-1]  # averaged over the last 300 samples
    right = next(g for g, group in enumerate(diagnosis.groups) if fault in group)
    rival = max((g for g in range(len(final)) if g != right), key=lambda g: final[g])
    best = diagnosis.groups[int(np.argmax(final))]
    return best, final.max(), final[right] - final[rival], diagnosis.groups[rival]


def said(diagnosis):
    """Return the word of the longest alarm, and the faults that it is about."""
    word = diagnosis.main_alarm.word
    return f"{word.kind}: {', '.join(word.names)}" if word.kind in ("good match", "either") else word.kind


def delay(diagnosis):
    """Return the seconds from the beginning of the fault to the first alarm after it."""
    return next(alarm.raised - ONSET for alarm in diagnosis.alarms if alarm.raised >= ONSET)


print(
    f"{'':2}  {'really failed':<13} {'delay':>6} {'(single)':>9}   {'best at the end':<32} {'score':>6} {'margin':>7}       word"
)
verdicts = {number: verdict(diagnosis, really[number]) for number, diagnosis in diagnoses.items()}
for number, diagnosis in diagnoses.items():
    best, score, margin, rival = verdicts[number]
    mark = "     " if really[number] in best else "WRONG"
    delays = f"{delay(diagnosis):4.0f} s {delay(single.run(*faulty[number])):7.0f} s"
    row = f"{number:2}  {really[number]:<13} {delays}   {' or '.join(best):<32} {score:6.3f} {margin:+7.3f}"
    print(f"{row} {mark} {said(diagnosis)}")
    word = diagnosis.main_alarm.word
    assert word.kind != "good match" or really[number] in word.faults[0]
correct = [number for number, (best, *_) in verdicts.items() if really[number] in best]
lasting = sum(d.alarm[-300:].all() for d in diagnoses.values())
early = [number for number, d in diagnoses.items() if any(alarm.raised < ONSET for alarm in d.alarms)]
print(f"in alarm throughout the last 300 samples: {lasting} of {len(diagnoses)}")
print(f"recordings with a false alarm before the fault: {', '.join(f'fault {n}' for n in early) or 'none'}")
print(f"best group contains the component that failed: {len(correct)} of {len(diagnoses)}")
assert lasting == len(diagnoses)
assert len(correct) >= 10

# %%
# Where a recording had a false alarm before the fault, a very short delay may be chance as well.
#
# One of them in full, a leak that the controllers hide (fault 9):
figure = plt.figure(figsize=(8, 8), layout="constrained")
plot_diagnosis(diagnoses[9], figure=figure)
plt.show()

# %%
# The close calls
# ---------------
# How alike are the directions? The cosine between every two groups, in residuals whitened by their covariance:
figure, ax = plt.subplots(figsize=(7.5, 6.5), layout="constrained")
plot_directions(monitor.generator, ax)
plt.show()

# %%
# - **The sensor of h1 and the clogged pipe 1-3** (faults 4 and 10) have the very same direction: the monitor names them
#   as one group and does not pretend to know which of the two it is. Both rows above that name this group are right
#   only in this sense.
# - **The sensor of h2 and the clogged pipe 3-2** (faults 5 and 12) are nearly parallel, 0.97 in this picture. Their
#   scores run close together, and here is how they develop:
figure, axes = plt.subplots(1, 2, figsize=(9, 3.4), sharey=True, layout="constrained")
for ax, number in zip(axes, (5, 12), strict=True):
    diagnosis = diagnoses[number]
    for name, colour in (("h2 sensor", "tab:orange"), ("clog 32", "tab:blue")):
        column = next(g for g, group in enumerate(diagnosis.groups) if name in group)
        ax.plot(diagnosis.time, diagnosis.scores[:, column], color=colour, label=name)
    ax.axvline(ONSET, color="0.6", linestyle=":", label="fault begins")
    ax.set(title=f"fault {number}: {really[number]}", xlabel="time [s]", ylim=(0.6, 1.01))
axes[0].set_ylabel("score over 300 s [–]")
axes[0].legend(loc="lower right")
plt.show()

for number in (5, 12):
    best, _, margin, rival = verdicts[number]
    print(f"fault {number}, {really[number]}: margin {margin:+.4f} over {' or '.join(rival)}")
    scores = diagnoses[number].scores[-300:]
    right, other = (
        next(g for g, group in enumerate(diagnoses[number].groups) if name in group)
        for name in (really[number], rival[0])
    )
    print(f"  right group in front in {np.mean(scores[:, right] > scores[:, other]):.0%} of the last 300 samples")

# %%
# Why is fault 12 not clearer? Nine tenths of the pipe are lost at its end. Levels have moved far from the operating point
# of the linear model, and the model's own error in the pipe next to it has become a good part of the effect:
nominal = np.array(LEVELS)
levels = faulty[12][1][-300:].mean(axis=0)
linear_13, linear_32 = (
    float(q * (1 + (levels - nominal) @ direction / (2 * nominal @ direction)))
    for q, direction in zip(np.array(pipe_flows(nominal))[[0, 2]], ([1, 0, -1], [0, -1, 1]), strict=True)
)
lost = float(np.mean(three_tank_fault(12)["clog 32"][-300:]))
q13, _, q32 = pipe_flows(levels, (0.0, 0.0, lost))
print("levels h1, h2, h3 in the last 300 s:", levels.round(1), "cm; at the operating point:", nominal, "cm")
print(f"flow 3-2: the linear model says {linear_32:.1f} cm3/s, the clogged pipe lets {q32:.1f} pass")
print(f"flow 1-3: the linear model says {linear_13:.1f} cm3/s, the healthy pipe lets {q13:.1f} pass")

# %%
# Is the noise model tuned to this result?
# ----------------------------------------
# It must not be: with labelled faults at hand one can always find the noise that ranks them best. This can be computed
# from the fault-free half alone: the likelihood of its innovations for several noise models, here per sample, of
# which there are thousands. Next to it stands how many of the eleven faults the same monitor would rank right.
settle = 300


def log_likelihood(generator):
    point = plant.operating_point
    u, y = normal[0][:half] - np.array(point.inputs), normal[1][:half] - np.array(point.outputs)
    r = generator.run(u, y)[settle:]
    r = r - r.mean(axis=0)
    S = generator.covariance
    return -0.5 * (np.linalg.slogdet(S)[1] + np.mean(np.sum(r * np.linalg.solve(S, r.T).T, axis=1)))


def count_right(generator):
    other = monitor_for(generator)
    found = {number: other.run(*recording) for number, recording in faulty.items()}
    return sum(really[number] in verdict(d, really[number])[0] for number, d in found.items())


print("process [cm2]  measurement [cm2]  log-likelihood  right")
table = {}
for process in (1e-6, 1e-5, 1e-4, 1e-3):
    for measurement in (0.01, 0.02, 0.04):
        other = rs.design.kalman_filter(plant.with_noise(process=process, measurement=measurement))
        table[process, measurement] = log_likelihood(other)
        published = "  published" if (process, measurement) == (1e-4, 0.02) else ""
        print(
            f"{process:13.0e}  {measurement:17g}  {table[process, measurement]:14.4f}  {count_right(other):5}{published}"
        )
best_noise = max(table, key=table.get)
print(f"most likely on fault-free data: process {best_noise[0]:g}, measurement {best_noise[1]:g}")

# %%
# The published noise is the most likely one on fault-free data, and it is what the table of eleven faults above was
# made with. Where another row of this table ranks one fault more, it does so with a noise model that the fault-free data
# speak against.
