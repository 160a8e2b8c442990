"""
When the model is not exact: parity relations for uncertain plants
==================================================================

A residual generator is made from a model, and no model is exact. What the model misses shows in the residual like a
fault. This page works on a motor whose model changes in three ways, and takes one method for each: a load that is one
of several (relations good for all of them), disturbances that are too many to decouple (the best ratio of fault to
disturbance), and a winding that warms up (residuals that do not answer to its resistance).
"""

import csv
from functools import cache
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import residua as rs

STEP = 0.02


@cache
def motor(R=1.0, k=0.5, inertia=0.1):
    """A direct-current motor: winding resistance in ohm, torque constant in N m/A, inertia in kg m²."""
    plant = rs.Plant(
        [[-2 * R, -2 * k], [k / inertia, -0.05 / inertia]],
        [[2.0], [0.0]],
        np.eye(2),
        inputs="voltage",
        outputs=["current", "speed"],
        states=["winding", "shaft"],
        units={"voltage": "V", "current": "A", "speed": "rad/s"},
        name="motor",
    )
    return plant.with_sensor_faults().with_noise(measurement=STEP * 0.01**2).discretize(STEP)


def voltage(steps, seed):
    """A drive that asks for another speed every second."""
    return np.repeat(1.0 + np.random.default_rng(seed).standard_normal(steps // 50 + 1), 50)[:steps, None]


def record(models, u, seed, bias=0.0):
    """Simulate a motor whose model changes along the recording, one model per sample; noise of 0.01 A and rad/s."""
    x, y = np.zeros(2), np.zeros((len(u), 2))
    for k, plant in enumerate(models):
        y[k] = x
        x = plant.A @ x + plant.B @ u[k]
    return y + 0.01 * np.random.default_rng(seed).standard_normal(y.shape) + bias


# %%
# Several models: one relation for all of them
# --------------------------------------------
# The motor carries one of five loads, and nobody tells the monitor which. Lou, Willsky and Verghese stack the windows of
# signals of all models and take the directions in which there is least. Each singular value is the root mean square of a
# residual in fault-free operation over all models; that of a relation is what its threshold must leave room for. The fault to
# see is a bias of the sensor of the speed.
loads = {inertia: motor(inertia=inertia).without_faults("current sensor") for inertia in (0.06, 0.08, 0.1, 0.12, 0.15)}
expected = {"order": 2, "correlation_time": 1.0, "noise": True}
robust = rs.design.multi_model_parity(loads.values(), nominal=2, criterion="faults", **expected)
alone = rs.design.multi_model_parity([loads[0.1]], criterion="faults", **expected)
print(robust)

# %%
# ``criterion="faults"`` asks for the largest response to constant faults for the leak. The smallest singular value, which
# the paper takes, belongs to a relation that sees hardly anything:
smallest = rs.design.multi_model_parity(loads.values(), nominal=2, **expected)
print(smallest)

# %%
# The design for the nominal load is better on that load, and worse on all others.
signals = {"correlation_time": 1.0, "noise": True}
leak = {
    "nominal load alone": rs.design.model_spread(alone.generator, loads.values(), **signals)[:, 0],
    "all loads": rs.design.model_spread(robust.generator, loads.values(), **signals)[:, 0],
}
gain = {"nominal load alone": abs(alone.gains[0, 0]), "all loads": abs(robust.gains[2, 0])}
fig, ax = plt.subplots(figsize=(6.5, 3.6), layout="constrained")
for (name, values), marker in zip(leak.items(), "os", strict=True):
    ax.plot(list(loads), values / gain[name][0], marker=marker, label=f"designed for {name}")
ax.set(xlabel="inertia [kg m²]", ylabel="bias of the speed [rad/s]", ylim=(0, None))
ax.set_title("Sensor bias as large as the residual without a fault", fontsize=10)
ax.legend()
plt.show()
worst = {name: round(float((values / gain[name]).max()), 3) for name, values in leak.items()}
print("bias that shows on the worst load, rad/s:", worst)

# %%
# In time: the lightest load is on, and at 60 s the sensor of the speed gets a bias.
steps = 6000
time = STEP * np.arange(steps)
u = voltage(steps, 1)
y = record([loads[0.06]] * steps, u, 2)
y[time >= 60, 1] += 1.0
fig, axes = plt.subplots(2, 1, figsize=(9, 4.6), sharex=True, layout="constrained")
for ax, (name, design) in zip(axes, {"nominal load alone": alone, "all loads": robust}.items(), strict=True):
    size = design.gains[0, 0, 0]
    r = np.convolve(design.generator.run(u, y)[:, 0], np.ones(25) / 25, mode="same") / size
    ax.plot(time, r, lw=0.8)
    ax.axvspan(60, time[-1], color="C3", alpha=0.1, lw=0)
    ax.set(ylabel="residual [rad/s]", title=f"Designed for {name}", ylim=(-4, 4))
axes[1].set(xlabel="time [s]")
axes[0].text(61, 2.9, "bias of the speed sensor: 1 rad/s", color="C3")
plt.show()

# %%
# The same for a civil aircraft at eleven masses (models of A. Varga, sensor faults of angle of attack and airspeed). The
# numbers are from ``benchmarks/aircraft_models.py``.
with (Path("..") / "data" / "aircraft_models.csv").open() as file:
    rows = [row for row in csv.DictReader(file) if row["order"] == "2"]
shown = (
    "nominal model, exact",
    "nominal model, faults for leak",
    "optimal against the variants",
    "all models, faults for leak",
)
fig, axes = plt.subplots(1, 2, figsize=(9, 3.4), sharey=True, layout="constrained")
for ax, (fault, unit) in zip(
    axes, {"AoA": "angle of attack [deg]", "VCAS": "airspeed [unit of the data]"}.items(), strict=True
):
    found = {row["design"]: row for row in rows if row["fault"] == fault}
    for k, name in enumerate(reversed(shown)):
        low, high = float(found[name]["nominal"]), float(found[name]["worst"])
        ax.plot([low, high], [k, k], color="C0", lw=5, alpha=0.35, solid_capstyle="butt")
        ax.plot(low, k, "o", color="C0", label="nominal model" if not k else None)
        ax.plot(high, k, "D", color="C3", label="worst of eleven" if not k else None)
    ax.set(xscale="log", xlabel=unit)
    ax.set_yticks(range(len(shown)), reversed(shown))
axes[0].legend(loc="lower right", fontsize=8)
fig.suptitle("Smallest bias that shows")
plt.show()

# %%
# Too many disturbances: the best ratio
# -------------------------------------
# A torque at the shaft and a drop of the supply both reach the motor, which has two sensors: nothing ignores them both
# and sees both sensors. Frank and Wuennenberg's relations are exact without disturbances, and of all exact relations of
# their order they see most of the fault for what they see of the disturbances. ``indices`` ranks them all.
plant = motor()
disturbed = plant.with_disturbances({"torque": [0.0, 0.2], "supply": 0.2 * plant.B[:, 0]})
best = rs.design.optimal_parity(disturbed, order=3, faults="speed sensor")
print(best)

# %%
# All of these relations are exact, and by their equations nobody tells them apart. Below, both disturbances act all the time;
# from 30 s on the sensor of the speed fails.
ranked = rs.design.optimal_parity(disturbed, order=3, faults="speed sensor", relations=4)
rng = np.random.default_rng(4)
d, f = rng.standard_normal((3000, 2)), np.zeros((3000, 2))
f[1500:, 1] = rng.standard_normal(1500)
drive = voltage(3000, 5)
y = disturbed.system(("control", "disturbance", "fault")).simulate(np.hstack([drive, d, f]))
r = ranked.generator.run(drive, y)
r /= r[10:1500].std(axis=0)
fig, axes = plt.subplots(1, 2, figsize=(9, 3.4), width_ratios=(1, 2), layout="constrained")
axes[0].bar(np.arange(1, len(best.indices) + 1), best.indices)
axes[0].set(xlabel="relation", ylabel="index: fault for disturbances")
for i, colour in ((0, "C0"), (3, "C1")):
    axes[1].plot(STEP * np.arange(3000), r[:, i], lw=0.6, label=f"relation {i + 1}", color=colour)
axes[1].axvspan(30, 60, color="C3", alpha=0.1, lw=0)
axes[1].set(
    xlabel="time [s]", ylabel="residual / its rms before", title="Random fault of the speed sensor from 30 s on"
)
axes[1].legend(loc="upper left")
plt.show()

# %%
# A parameter that drifts: residuals that do not answer to it
# -----------------------------------------------------------
# The winding warms up, and its resistance grows by a third over four minutes. That is no fault, but residuals see it.
# Gertler takes the derivatives of the primary residuals with respect to the resistance, which depend on the data, and
# projects them out at every sample. What is left ignores the resistance, to first order, and sees everything else.


def model(R, k):
    return motor(R, k)


nominal = {"R": 1.0, "k": 0.5}
poles = [0.95, 0.95]
plain = rs.design.insensitive_parity(model, nominal, isolate="k", poles=poles)  # its first member ignores nothing
insensitive = rs.design.insensitive_parity(model, nominal, insensitive_to="R", poles=poles)
steps = 12000
time, u = STEP * np.arange(steps), voltage(steps, 11)
free = record([motor()] * steps, u, 12)
plain, insensitive = (one.fit(u, free, false_alarm_rate=1e-3) for one in (plain, insensitive))

u = voltage(steps, 13)
resistance = 1 + 0.33 * time / time[-1]
warming = [motor(R) for R in np.round(resistance, 2)]
weak = [motor(R, 0.47 if t >= 180 else 0.5) for R, t in zip(np.round(resistance, 2), time, strict=True)]
y = record(weak, u, 14)
fig, axes = plt.subplots(2, 1, figsize=(9, 4.6), sharex=True, layout="constrained")
for ax, (name, one) in zip(axes, {"Nothing ignored": plain, "Resistance ignored": insensitive}.items(), strict=True):
    found = one.run(u, y)
    ax.plot(time, found.statistic[:, 0], lw=0.8)
    ax.axhline(one.thresholds[0], color="0.4", ls="--", lw=1)
    ax.axvspan(180, time[-1], color="C3", alpha=0.1, lw=0)
    ax.set(ylabel="size [noise]", title=name)
    before = found.fired[time < 180, 0].mean()
    print(f"{name}: in alarm {before:.1%} of the time before the fault, {found.fired[time >= 180, 0].mean():.1%} after")
axes[0].text(181, 0.9 * axes[0].get_ylim()[1], "magnets weaken by 6 %", color="C3", va="top")
axes[1].set(xlabel="time [s], resistance rising by a third")
plt.show()
quiet = insensitive.run(u, record(warming, u, 14)).fired[:, 0].mean()
print(f"with the drift alone, over all four minutes: {quiet:.2%} false alarms (aimed at 0.1 %)")

# %%
# It is insensitive to first order: what is left of a change grows with its square. (After ``fit`` the noise is known, and
# directions that are shorter than a tenth of it are left in: of the expected change, a tenth of the resistance, up to a
# twentieth of the noise may then be left, also at first order. At rest nothing is taken off.)
exact = rs.design.insensitive_parity(model, nominal, insensitive_to="R", poles=poles)
changes = np.logspace(-3, -0.5, 12)
left = []
for change in changes:
    e = exact.run(u[:2000], motor(1 + change).system(("control",)).simulate(u[:2000]))
    left.append((np.abs(e.primary).max(), np.abs(e.residuals).max()))
fig, ax = plt.subplots(figsize=(6, 3.6), layout="constrained")
ax.loglog(changes, np.array(left), "o-", label=["nothing ignored", "resistance ignored"])
ax.set(xlabel="relative change of the resistance", ylabel="largest residual [effect of + 10 %]")
ax.legend()
plt.show()
slopes = np.polyfit(np.log(changes[:8]), np.log(np.array(left)[:8]), 1)[0]
print("powers of the change:", slopes.round(2).tolist())

# %%
# Which parameter was it?
# -----------------------
# The same residuals isolate parameters. In a bank each member ignores one of them; a change of that one fires all others,
# and anything else fires them all.
bank = rs.design.insensitive_parity(model, nominal, isolate=["R", "k"], poles=poles)
print(bank)
u = voltage(steps, 11)
bank = bank.fit(u, free, false_alarm_rate=1e-3)
u = voltage(3000, 21)
cases = {
    "nothing": record([motor()] * 3000, u, 22),
    "resistance + 10 %": record([motor(1.1)] * 3000, u, 22),
    "magnets - 5 %": record([motor(k=0.475)] * 3000, u, 22),
    "sensors + 0.2": record([motor()] * 3000, u, 22, bias=0.2),
}
for name, y in cases.items():
    fired = bank.run(u, y).fired[500:]
    index, readings = rs.decide.read_codes(fired, bank.codes, bank.causes, members=bank.members)
    most = readings[np.bincount(index).argmax()]
    share = np.bincount(index).max() / len(index)
    print(f"{name:18} -> {most.meaning}  ({share:.0%} of the samples)")
