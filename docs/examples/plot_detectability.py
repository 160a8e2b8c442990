"""
How small a fault is seen, and how soon
=======================================

Before a monitor goes to the plant someone asks how small a leak it sees, and how late. For each fault
:func:`residua.decide.detectability` answers with the smallest size that is detected within a delay in 95 of 100 cases, the mean
delay, and what the best of all tests would need. Here for three tanks in a row, whose levels are measured and which may leak.
"""

import matplotlib.pyplot as plt
import numpy as np

import residua as rs
from residua.library import three_tank

# %%
# The plant
# ---------
# The three-tank benchmark, linear around its operating point, a second from sample to sample; levels are in cm, and a leak is a
# hole of so many cm².
plant = three_tank(dt=1.0)
kalman = rs.design.kalman_filter(plant)
faults = ["leak 2", "clog 13", "h2 sensor"]

# %%
# Three tests, each with a false alarm every 28 hours, that is 100,000 samples.
tests = {
    "single samples": rs.decide.NormThreshold(persistence=1, false_alarm_rate=1e-5),
    "CUSUM": rs.decide.CUSUM(shift=0.5, mean_time_between_false_alarms=1e5),
    "GLR": rs.decide.GLR(window=40, mean_time_between_false_alarms=1e5),
}
delays = [3, 10, 30, 100]
seen = {
    name: rs.decide.detectability(rs.Monitor(kalman, test=test), within=delays, faults=faults, runs=1000, seed=1)
    for name, test in tests.items()
}
print(seen["CUSUM"])

# %%
# Power against size
# ------------------
# The probability of a detection within 30 s. A leak has to be larger for single samples: it lowers a level slowly, and only a
# sum shows a small slope. A sensor that is off shows at once and then is taken for the level: there the three are closer.
fig, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
for ax, fault, unit in zip(axes, ("leak 2", "h2 sensor"), ("cm²", "cm"), strict=True):
    for name, one in seen.items():
        sizes, probability = one.power(fault, within=30)
        ax.plot(sizes, probability, label=name)
    ax.axhline(0.95, color="0.6", linewidth=0.8)
    ax.set(xscale="log", xlabel=f"size of {fault} [{unit}]", ylabel="detected within 30 s", title=fault)
axes[0].legend()
plt.show()

# %%
# Delay against the best test
# ---------------------------
# Each dot is the smallest fault that is seen within 3, 10, 30 or 100 s: its size and its mean delay. The dashed line is Lorden's
# asymptote, what the best test with as rare false alarms needs, if it knows the fault's response beforehand.
fig, ax = plt.subplots(figsize=(7, 4.5), layout="constrained")
for name, one in seen.items():
    rows = [row for row in one.smallest if row.fault == "leak 2" and np.isfinite(row.size.value)]
    (line,) = ax.plot([row.size.value for row in rows], [row.mean_delay.value for row in rows], marker="o", label=name)
rows = sorted(
    (row for one in seen.values() for row in one.smallest if row.fault == "leak 2"), key=lambda r: r.size.value
)
rows = [row for row in rows if np.isfinite(row.asymptote)]
ax.plot([row.size.value for row in rows], [row.asymptote for row in rows], "k--", linewidth=1, label="Lorden")
ax.set(xscale="log", yscale="log", xlabel="size of leak 2 [cm²]", ylabel="mean delay [s]", title="leak 2")
ax.legend()
plt.show()

# %%
# Whether it is true
# ------------------
# A campaign simulates the plant itself. Faults of the sizes above should be detected within 30 s in 95 of 100 runs.
watch = rs.Monitor(kalman, test=tests["CUSUM"])
wanted = [row for row in seen["CUSUM"].smallest if row.within == 30]
scenarios = [rs.validate.Scenario(row.fault, rs.validate.step(at=300), size=row.size.value) for row in wanted]
print(rs.validate.campaign(watch, scenarios, runs=1000, samples=340, seed=2, within=30, progress=False).table())
