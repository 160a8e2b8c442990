"""
Three tanks with banks: codes instead of directions
===================================================

A bank is a set of residual generators that each ignore some faults. Which of them fire is the code of the fault. This
page gives the recordings of :doc:`plot_three_tank` to two banks and to the monitor of that page, which judges the
direction of Kalman innovations: which faults does each isolate that the others do not?

Everything on this page is computed when the page is built; where the recordings are absent, the same faults are
simulated with the benchmark's nonlinear model, and the first line of output says which of the two it was.
"""

import os
from pathlib import Path

import matplotlib.pyplot as plt
import scipy.io

import residua as rs
from residua.library import simulate_three_tank, three_tank, three_tank_fault

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

# %%
# A generalized sensor bank
# -------------------------
# One member per level sensor, which uses all measurements but that one. The plant has noise, so that each member takes
# the gain of a Kalman filter for what it sees, and its residual is white. A sensor fault fires all members but one;
# everything else fires all three: this bank knows sensors and nothing more.
plant = three_tank()
sensors = rs.design.sensor_fault_bank(plant, observer="minimal")
print(sensors)

# %%
# A bank for all eleven faults
# ----------------------------
# One member per fault, which ignores it. Which others it sees is no choice: :func:`residua.diagnosability` has worked it
# out from ranks, and the structure is read off there. A leak of tank 1 acts as pump 1 does, and shares its code.
isolable = rs.diagnosability(plant).isolable
structure = {
    f"ignores {name}": [other for i, other in enumerate(plant.faults) if isolable[i, j]]
    for j, name in enumerate(plant.faults)
}
everyone = rs.design.structured_bank(plant, structure)
print(everyone)

# %%
# On the recordings
# -----------------
# All three are fitted to the first half of the fault-free recording, for half a per cent of samples in alarm. The direction has
# the test that a monitor has without an option. The two banks judge sums over 30 samples, and raise an alarm after ten in a row:
# with the default test the bank of all misreads one fault more, that of the sensor of h1.
test = rs.decide.NormThreshold(window=30, persistence=10)
monitors = {
    "direction": rs.Monitor(rs.design.kalman_filter(plant), isolate=rs.decide.Directional(window=300)),
    "sensor bank": rs.Monitor(sensors, test=test),
    "bank of all": rs.Monitor(everyone, test=test),
}
for name, monitor in monitors.items():
    monitor.fit(normal[0][:half], normal[1][:half], false_alarm_rate=0.005)
    quiet = monitor.run(normal[0][half:], normal[1][half:])
    print(f"{name:<12} false alarms on the second half of the fault-free recording: {quiet.false_alarm_fraction:.2%}")

# %%
# What each says of each recording. "ok" names the failed component, alone or in its group; a sensor bank that says
# "none of the sensors" for another component is right as far as it goes.
found = {(name, k): monitor.run(*faulty[k]) for name, monitor in monitors.items() for k in FAULTS}
others = next(group for group in sensors.groups if len(group) > 1)


def verdict(name, number):
    """Return delay and verdict on one recording."""
    alarm = found[name, number].main_alarm
    if alarm is None:
        return "not seen"
    best = alarm.candidates[0].faults if alarm.candidates else ()
    right = really[number] in best
    if not best:
        said = "knows no such code"
    elif best == others:
        said = "none of the sensors" + ("" if right else ", wrong")
    else:
        said = ("ok" if right else "wrong") + f": {best[0]}" + (f" or {len(best) - 1} more" if len(best) > 1 else "")
    return f"{alarm.raised - ONSET:4.0f} s  {said}"


print(f"{'':14}" + "".join(f"{name:<34}" for name in monitors))
for k in FAULTS:
    print(f"{really[k]:<14}" + "".join(f"{verdict(name, k):<34}" for name in monitors))

# %%
# Who isolates what, counted. An answer counts as isolation when it holds the failed component and no more than the
# faults that no method can tell from it, at all or while both are constant (these grow slowly).
possible = rs.diagnosability(plant)
twins = {
    name: (*next((g for g in possible.groups if name in g), (name,)), *possible.constant_twins(name))
    for name in plant.faults
}


def isolates(name, number):
    alarm = found[name, number].main_alarm
    return (
        alarm is not None
        and bool(alarm.candidates)
        and really[number] in alarm.candidates[0].faults
        and set(alarm.candidates[0].faults) <= set(twins[really[number]])
    )


hits = {name: {k for k in FAULTS if isolates(name, k)} for name in monitors}
for name in ("sensor bank", "bank of all"):
    more, less = hits[name] - hits["direction"], hits["direction"] - hits[name]
    print(f"{name}: isolates {len(hits[name])} of {len(FAULTS)}")
    print(f"  and the direction does not: {', '.join(really[k] for k in sorted(more)) or 'none'}")
    print(f"  the direction does, the bank does not: {', '.join(really[k] for k in sorted(less)) or 'none'}")

# %%
# Who fires when h3's sensor fails
# --------------------------------
# The statistic of each member over its threshold. Two members leave it far behind; the one that does not use h3 stays
# around it: the controllers trust the wrong level and drive the tanks away from the point where the linear model holds,
# and that is all it sees. A member counts as fired when it is in alarm at least half as long as the one that is longest.
shown = found["sensor bank", 6]
fig, axes = plt.subplots(len(sensors.members), 1, sharex=True, figsize=(8, 5), layout="constrained")
for ax, member, statistic in zip(axes, sensors.members, shown.parts.statistics.T, strict=True):
    ax.plot(shown.time, statistic, lw=0.8)
    ax.axhline(1.0, color="tab:red", lw=1)
    ax.axvline(ONSET, color="0.6", ls=":")
    ax.set(ylabel="statistic /\nthreshold", title=member, yscale="log", ylim=(0.03, None))
axes[-1].set_xlabel("time in s")

# %%
# Codes and directions use the same information differently. A code asks each member yes or no, so that it needs no
# direction to hold and no size to be known, and it can say "none of mine": for the two faults that grow until the linear
# model no longer holds, the bank says that it knows no such code, where the direction ranks, rightly once and wrongly
# once. A direction weighs all residuals against each other and always ranks. It is the quickest of the three for most
# faults; the sensor bank answers one question only. Two faults that look alike while constant (h1's sensor and a
# clogged pipe 1-3) are named together by all three.
