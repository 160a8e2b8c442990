"""
Matched filters: which fault, since when, how large
===================================================

The innovations of a Kalman filter are white noise while all is well. A fault adds a bias to them that turns while the
filter settles: its direction depends on the fault and on how long ago it arrived. Matched filters expect just that, for
every fault and every arrival time, and take the expectation that fits best (Gertler 1991, section 5.3). Unlike a
direction, that gives the arrival time and the size too; unlike a structured residual, it needs a noise model, and it
assumes that the fault is a step.

Everything on this page is simulated, with fixed seeds.
"""

import matplotlib.pyplot as plt
import numpy as np

import residua as rs

# %%
# The plant
# ---------
# Gertler's second-order example, with two process faults and two sensor faults, and with noise.
plant = rs.library.gertler(sensor_faults=True).with_noise(process=0.01, measurement=0.1)
matched = rs.design.matched_filters(plant, window=30)
print(matched)

# %%
# The expected responses to a step of size one: what the innovations do after each fault has arrived. That to the failed
# sensor ``y2`` jumps and then falls to a third, for the filter comes to believe the sensor.
fig, axes = plt.subplots(2, 2, sharex=True, figsize=(8, 4.5), layout="constrained")
for j, (ax, fault) in enumerate(zip(axes.flat, plant.faults, strict=True)):
    for i, output in enumerate(plant.outputs):
        ax.plot(matched.responses[:, i, j], ".-", lw=0.8, label=f"innovation of {output}")
    ax.set_title(fault)
axes[0, 0].legend()
for ax in axes[1]:
    ax.set_xlabel("samples since the fault arrived")
for ax in axes[:, 0]:
    ax.set_ylabel("innovation per unit of fault")

# %%
# How alike the faults look, 30 samples after they arrived: 1 would mean that nothing tells them apart.
print(matched.similarity().round(2))


# %%
# A fault is found
# ----------------
# The noise of the model gives the threshold; no fault-free data are needed.
def recording(fault, size, *, seed=0, onset=100, samples=300, of=plant):
    rng = np.random.default_rng(seed)
    f = np.zeros((samples, len(of.faults)))
    f[onset:, of.faults.index(fault)] = size
    u, w = rng.standard_normal((samples, 1)), rng.standard_normal((samples, len(of.noises)))
    return u, of.system(("control", "fault", "noise")).simulate(np.hstack([u, f, w]))


monitor = rs.Monitor(matched)
diagnosis = monitor.run(*recording("y2 sensor", 2.0))
print(diagnosis)

# %%
# What the monitor thought, sample by sample, while the arrival lies within the window: the most likely size of that fault,
# with one standard deviation, and the likelihood of each. The estimates sharpen while data come in. Later the test no
# longer sees how the fault began: name and arrival are held.
match, alarm = diagnosis.match, diagnosis.main_alarm
shown = slice(alarm.start, 100 + matched.window + 1)
fig, (top, bottom) = plt.subplots(2, 1, sharex=True, figsize=(8, 5), layout="constrained")
j = plant.faults.index("y2 sensor")
size, spread = match.sizes[shown, j], match.deviations[shown, j]
top.fill_between(diagnosis.time[shown], size - spread, size + spread, alpha=0.3)
top.plot(diagnosis.time[shown], size, ".-")
top.axhline(2.0, color="0.5", ls=":")
top.set(ylabel="size of y2 sensor", title="Size, with one standard deviation; dotted: the true one")
for k, fault in enumerate(plant.faults):
    bottom.plot(diagnosis.time[shown], match.ratios[shown, k], label=fault)
bottom.set(ylabel="2 ln likelihood ratio", xlabel="time in s", yscale="log")
bottom.legend(ncols=4)

# %%
# The simplified version, and what it costs
# -----------------------------------------
# Each fault can be represented by its steady response alone: one direction per fault, no arrival time. While the residual
# turns towards that direction, the name may be wrong. Two tanks in a row show it: a change of the inflow is seen in the
# first level at once and settles in both, so that at first it looks like a fault of the first level sensor. The same 200
# recordings with both versions: the fraction of samples over the threshold that are put down to another fault.
tanks = rs.Plant([[0.9, 0], [0.08, 0.95]], [[1.0], [0]], np.eye(2), dt=1.0, outputs=["level 1", "level 2"])
tanks = tanks.with_faults({"inflow": [1, 0], "leak 2": [0, 1]}).with_sensor_faults()
tanks = tanks.with_noise(process=1e-3, measurement=0.1)
runs = [recording("inflow", 0.6, seed=seed, of=tanks) for seed in range(200)]
u, y = (np.array(part) for part in zip(*runs, strict=True))
ages = np.arange(2, 40)
fig, ax = plt.subplots(figsize=(8, 3.2), layout="constrained")
for steady, label in ((False, "all arrival times"), (True, "steady responses only")):
    bank = rs.design.matched_filters(tanks, window=30, steady=steady)
    found = rs.Monitor(bank).update(u, y)
    wrong = (found.match.ratios.argmax(axis=2) != 0) & found.exceeded
    fraction = (wrong.sum(axis=0) / np.maximum(found.exceeded.sum(axis=0), 1))[100 + ages]
    ax.plot(ages, fraction, ".-", label=label)
    first, last = fraction[:6].mean(), fraction[-10:].mean()
    print(f"{label}: wrong name in {first:.0%} of the first samples, {last:.0%} at the end")
    print(f"  groups: {', '.join(' or '.join(group) for group in bank.groups)}")
ax.set(xlabel="samples since the fault arrived", ylabel="fraction put down\nto another fault", ylim=(-0.02, 1))
ax.legend()

# %%
# The groups differ too: a leak of the second tank and its level sensor settle to the same direction, and only the way
# there tells them apart.

# %%
# How good are arrival and size?
# ------------------------------
# 400 recordings with faults of six to twelve standard deviations: how often the name is right, how far the arrival is off,
# and how the error of the size compares with the standard deviation that the monitor gives.
rng = np.random.default_rng(1)
late, off, right = [], [], 0
for seed in range(400):
    fault = plant.faults[seed % 4]
    size = matched.deviation()[fault] * rng.uniform(6, 12)
    found = monitor.run(*recording(fault, size, seed=1000 + seed)).main_alarm
    if found is None or fault not in found.candidates[0].faults:
        continue
    right += 1
    told = found.candidates[0].sizes[0]
    off.append((told.mean - size) / told.deviation)
    late.append(np.nan if found.arrival is None else found.arrival - 100)
late, off = np.array(late), np.array(off)
print(f"named rightly: {right} of 400")
print(f"arrival exact in {np.mean(late == 0):.0%}, within 2 samples in {np.mean(np.abs(late) <= 2):.0%}")
print(
    f"size: error of {np.sqrt(np.mean(off**2)):.2f} standard deviations (rms), over 3 in {np.mean(np.abs(off) > 3):.1%}"
)

# %%
# What matched filters assume: one fault at a time, a step, white innovations (that is, a model and a noise model that are
# right), and an arrival within the window, which is longer than the responses take to settle; where it is not, the print of
# the matched filters and every diagnosis say so. A fault that grows is still named, and its alarm is not put later than it
# was raised; but its first size is that of the step which its beginning resembles.
#
# Two faults are a close call where the second is less than 20 times as unlikely as the first. That holds for a model that is
# right. Where neither of the two fits to within the noise, and they differ by less than what is left, the diagnosis says so
# too: then an error of the model may decide, however large the lead in likelihood is.
