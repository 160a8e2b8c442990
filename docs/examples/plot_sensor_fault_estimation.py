"""
What should this sensor read?
=============================

The second experiment of Sueur (Observer-based actuator and sensor fault estimation, section 3.2): one sensor of an
aircraft lies for a second. One estimator per sensor tells which, by how much, and what it should have read.
"""

import matplotlib.pyplot as plt
import numpy as np

import residua as rs

aircraft = rs.library.vtol()
bank = rs.design.sensor_fault_estimators(aircraft, poles=[-30, -40, -40, -50])
print(bank)

# %%
# Each member takes the fault of its own sensor for an unknown input; it estimates the state from the other two. A sensor
# fault shows in the measurement at once, so that its estimate, :math:`y_j - c_j \hat x`, needs neither derivative nor
# filter: its lag is zero.
#
# The pulse
# ---------
# The horizontal velocity reads one too high from the first second to the second.
h = 0.001
times = np.arange(3001) * h
u = np.ones((len(times), 2))
healthy = aircraft.system("control").discretize(h).simulate(u, [0.01, 0, 0, 0])
pulse = ((times > 1) & (times <= 2)).astype(float)
y = healthy + np.column_stack([pulse, 0 * pulse, 0 * pulse])

estimator = bank["v_horizontal"]
estimate = estimator.estimate(u, y, dt=h)[:, 0]
virtual = estimator.virtual_outputs(u, y, dt=h)[:, 0]

figure, (top, bottom) = plt.subplots(2, sharex=True, figsize=(8, 5), layout="constrained")
top.plot(times, pulse, color="0.6", linewidth=3, label="fault of the sensor")
top.plot(times, estimate, linewidth=1.2, label="estimate")
top.set_ylabel("fault [kn]")
top.legend(loc="upper right")
bottom.plot(times, y[:, 0], color="0.6", linewidth=3, label="as measured")
bottom.plot(times, virtual, linewidth=1.2, label="virtual sensor: what it should read")
bottom.plot(times, healthy[:, 0], "k:", label="truth")
bottom.set_ylabel("v_horizontal [kn]")
bottom.set_xlabel("time [s]")
bottom.set_ylim(-0.1, 1.9)
bottom.legend(loc="upper right", ncol=3, fontsize=8)
plt.show()

late = times > 0.8
for what, found, truth in (("estimate", estimate, pulse), ("virtual sensor", virtual, healthy[:, 0])):
    assert np.abs(found - truth)[late].max() < 1e-7
    print(f"largest error of the {what} after 0.8 s: below 1e-7 kn")

# %%
# Which sensor is it?
# -------------------
# Every member makes an estimate, and two of the three are wrong: they trust the sensor that lies. Which to believe is
# told by the output errors of their observers: they stay zero for the member whose sensor it is, and only for that.
errors = {name: np.abs(member.consistency().run(u, y, dt=h)).max(axis=1) for name, member in bank.items()}
figure, axes = plt.subplots(3, sharex=True, figsize=(8, 5), layout="constrained")
for ax, (name, error) in zip(axes, errors.items(), strict=True):
    ax.plot(times[late], error[late])
    ax.set_title(f"estimator of the sensor {name}", fontsize=9)
    ax.set_ylabel("output error")
    ax.set_ylim(-0.05, 1.05)
axes[-1].set_xlabel("time [s]")
plt.show()
for name, error in errors.items():
    print(f"{name:<14} largest output error after 0.8 s {error[late].max():.4f}")
assert min(errors, key=lambda name: errors[name][late].max()) == "v_horizontal"

# %%
# A sensor and an actuator at once
# --------------------------------
# With three measurements, one actuator and one sensor may fail at the same time; the estimator keeps them apart. Here the
# horizontal velocity drifts while the collective pitch is off by a sine.
both = rs.design.fault_estimator(
    aircraft, faults=["collective actuator", "v_horizontal sensor"], margin=8, bandwidth=60
)
print(both, {name: round(lag, 4) for name, lag in both.lag.items()})
times = np.arange(8001) * h
u = np.ones((len(times), 2))
faults = np.zeros((len(times), len(aircraft.faults)))
faults[:, 0] = 0.3 * np.sin(2 * np.clip(times - 3, 0, None))
faults[:, 2] = 0.2 * np.clip(times - 2, 0, 3)
system = aircraft.system(("control", "fault")).discretize(h, hold=["zero"] * 2 + ["linear"] * 5)
y = system.simulate(np.hstack([u, faults]))
found = both.estimate(u, y, dt=h)

figure, axes = plt.subplots(2, sharex=True, figsize=(8, 4.6), layout="constrained")
for ax, name, estimate in zip(axes, both.faults, found.T, strict=True):
    ax.plot(times, faults[:, aircraft.faults.index(name)], color="0.6", linewidth=3, label="fault")
    ax.plot(times, estimate, linewidth=1.2, label="estimate")
    ax.set_ylabel(name)
axes[0].legend(loc="upper left")
axes[-1].set_xlabel("time [s]")
plt.show()
late = times > 1.5
for k, name in enumerate(both.faults):
    error = np.abs(found[late, k] - faults[late, aircraft.faults.index(name)]).max()
    print(f"{name}: largest error {error:.4f}")

# %%
# Two actuators and a sensor, or three sensors, are too many for three measurements. The refusal says why:
try:
    rs.design.fault_estimator(aircraft, faults=["collective actuator", "cyclic actuator", "v_horizontal sensor"])
except rs.errors.DesignError as error:
    print(error)
