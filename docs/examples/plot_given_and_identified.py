"""
Three tanks: a given model beside identified ones
=================================================

A model from first principles is seldom at hand; a log file is. Here the same faults meet four monitors of the same three
tanks: with the model that is given, with one identified from a log of normal operation, with one identified from a log in
which somebody moved the set points, and with the tanks' own equations whose three coefficients come from the normal log.
What an identified model can say depends on what the log contains, and its report says so before a fault does.

Everything is simulated with the benchmark's nonlinear model and fixed seeds: controllers hold two of the levels
throughout.
"""

import matplotlib.pyplot as plt
import numpy as np

import residua as rs
from residua.library import simulate_three_tank, three_tank, three_tank_fault
from residua.library.three_tank import AREA, FLOWS, GRAVITY, LEVELS, PIPE

# %%
# Two logs
# --------
# A quiet one of an hour, and one of the same length in which the two set points step every five minutes by up to 1.5 cm.
STEPS = 3600
quiet = simulate_three_tank(STEPS, seed=1)
rng = np.random.default_rng(0)
moved = np.repeat(np.array(LEVELS[:2]) + rng.uniform(-1.5, 1.5, (STEPS // 300, 2)), 300, axis=0)
lively = simulate_three_tank(STEPS, setpoints=moved, seed=2)

fig, axes = plt.subplots(2, 2, sharex=True, sharey="row", figsize=(8, 4.2), layout="constrained")
for column, (title, log) in zip(axes.T, {"quiet": quiet, "set points moved": lively}.items(), strict=True):
    column[0].plot(log.y, lw=0.7, label=["h1", "h2", "h3"])
    column[1].plot(log.u, lw=0.7, label=["Q1", "Q2"])
    column[0].set_title(title)
    column[1].set_xlabel("time in s")
axes[0, 0].set_ylabel("level in cm")
axes[1, 0].set_ylabel("flow in cm³/s")
axes[0, 0].legend(loc=(0.02, 0.58), ncols=3)
axes[1, 0].legend(loc="center left", ncols=2)

# %%
# Identified models
# -----------------
channels = {"inputs": ["Q1", "Q2"], "outputs": ["h1", "h2", "h3"], "dt": 1.0}
from_quiet = rs.identify.subspace(quiet.u, quiet.y, **channels)
from_lively = rs.identify.subspace(lively.u, lively.y, **channels)
print(from_quiet.report)

# %%
# The report of the quiet log warns: the inputs follow the levels and nothing else, so that the steady gains are
# unknown. That of the lively log has the gains with their standard errors.
print(from_lively.report)

# %%
# What a constant flow does to the levels in the end, by each model, with two standard errors: bars that leave the
# picture say that nothing is known.
truth = three_tank().system("control").dc_gain()
fig, ax = plt.subplots(figsize=(8, 3.2), layout="constrained")
where = np.arange(truth.size)
names = [f"{h} from {q}" for h in ("h1", "h2", "h3") for q in ("Q1", "Q2")]
ax.plot(where, truth.ravel(), "k_", ms=22, mew=2, label="given")
for shift, label, model in ((-0.12, "quiet log", from_quiet), (0.12, "lively log", from_lively)):
    gain = model.report.steady_gain
    known = np.isfinite(gain.error.ravel())
    print(f"{label}: {known.sum()} of {known.size} steady gains are known")
    spread = np.where(known, 2 * gain.error.ravel(), 10)  # beyond the picture
    ax.errorbar(where + shift, gain.gain.ravel(), spread, fmt="o", ms=4, capsize=3, label=label)
ax.set_xticks(where, names)
ax.set(ylabel="steady gain in cm per cm³/s", ylim=(-1, 3))
ax.legend()


# %%
# The tanks' own equations
# ------------------------
# Who knows the equations and not the coefficients asks the log for these alone.
def tanks(a1, a2, a3):
    def flow(a, drop):
        return a * PIPE * np.sign(drop) * np.sqrt(2 * GRAVITY * abs(drop))

    def rate(h, q):
        q13, q20, q32 = flow(a1, h[0] - h[2]), flow(a2, h[1]), flow(a3, h[2] - h[1])
        return np.array([q[0] - q13, q[1] + q32 - q20, q13 - q32]) / AREA

    made = rs.identify.tangent_model(rate, at=(LEVELS, FLOWS), hold={"h1": LEVELS[0], "h2": LEVELS[1]}, **named)
    plant = made.plant.discretize(1.0)
    directions = three_tank()
    for name, bf in zip(directions.faults, directions.Bf.T, strict=True):
        if name.startswith(("leak", "clog")):
            plant = plant.with_faults({name: bf})
    return plant.with_actuator_faults().with_sensor_faults().with_noise(process=1e-4, measurement=0.02)


named = {"inputs": ["Q1", "Q2"], "states": ["h1", "h2", "h3"], "outputs": ["h1", "h2", "h3"]}
grey = rs.identify.grey_box(tanks, (quiet.u, quiet.y), dict.fromkeys(("a1", "a2", "a3"), (0.2, 0.5, 0.9)), dt=1.0)
print(grey)

# %%
# Eleven faults
# -------------
# Each begins at 200 s and grows slowly. A monitor is the Kalman filter of its model, with the threshold from the quiet
# log, sums over 30 s and names over the last 300 s. Leaks and clogged pipes have no direction in a model
# that knows only inputs and outputs: the identified ones look for failed sensors and pumps.
models = {
    "given": three_tank(),
    "quiet log": from_quiet.plant.with_sensor_faults().with_actuator_faults(),
    "lively log": from_lively.plant.with_sensor_faults().with_actuator_faults(),
    "equations, quiet log": grey.plant,
}
faults = {number: three_tank_fault(number, onset=200) for number in range(2, 13)}
runs = {number: simulate_three_tank(2001, faults=courses, seed=number) for number, courses in faults.items()}
test = rs.decide.NormThreshold(window=30, persistence=10)
outcome, detected = {}, {}
for label, plant in models.items():
    monitor = rs.Monitor(rs.design.kalman_filter(plant), test=test, isolate=rs.decide.Directional(window=300))
    monitor.fit(quiet.u, quiet.y, false_alarm_rate=0.005)
    outcome[label], share = [], []
    for number, run in runs.items():
        diagnosis = monitor.run(run.u, run.y)
        best = diagnosis.groups[int(np.argmax(diagnosis.scores[-1]))]  # over the last 300 samples
        outcome[label].append((" or ".join(best), bool(set(best) & set(faults[number]))))
        share.append(np.mean(diagnosis.alarm[200:]))
    detected[label] = np.mean(share)

fig, ax = plt.subplots(figsize=(9, 3.6), layout="constrained")
ax.axis("off")
rows = [next(iter(faults[number])) for number in runs]
cells = [[outcome[label][k][0] for label in models] for k in range(len(rows))]
colours = [["#cfe8cf" if outcome[label][k][1] else "#f6d5d0" for label in models] for k in range(len(rows))]
table = ax.table(cells, colours, rowLabels=rows, colLabels=list(models), loc="center", cellLoc="center")
table.scale(1, 1.2)
table.auto_set_font_size(False)
table.set_fontsize(8)

for label in models:
    right = sum(one[1] for one in outcome[label])
    print(f"{label:<22} {right:2d} of {len(runs)} named, {detected[label]:.0%} of the faulty time in alarm")

# %%
# All four see that something is wrong. For a name the quiet log is not enough: its model takes every fault for a failed
# sensor, because it does not know what the pumps do. Set points that moved for an hour give a model that names all
# failed sensors and pumps; a leak it calls by the pump of the same tank, whose flow is missing just as much. The equations
# make up for what the log does not show: three coefficients from the quiet log name as much as the given model.
