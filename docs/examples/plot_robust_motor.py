"""
From physical parameters to certified thresholds: a motor whose friction nobody knows
=====================================================================================

What is known of most plants is a formula and what its parameters lie between. This page goes the whole way with a DC motor:
equations, sampling, the loop, a bank whose thresholds hold for every such motor, and a recording of one of them.
"""

import matplotlib.pyplot as plt
import numpy as np

import residua as rs

# %%
# The plant, as a function of what is not known
# ---------------------------------------------
# Current and speed of the motor, driven by a voltage, with sensors of both. Disturbances are given by how large they get: a
# load torque of 0.005 Nm, and errors of the two sensors. **Together** they have length one, so that of three which
# are bounded one by one each is multiplied by the root of three.
NOMINAL = {"resistance": 1.0, "inertia": 0.01, "friction": 0.002}
TORQUE, INDUCTANCE, ROOT = 0.05, 0.05, np.sqrt(3)


def motor(values):
    """Return the motor with given parameters."""
    R, J, b = values["resistance"], values["inertia"], values["friction"]
    plant = rs.Plant(
        [[-R / INDUCTANCE, -TORQUE / INDUCTANCE], [TORQUE / J, -b / J]],
        [[1 / INDUCTANCE], [0]],
        np.eye(2),
        inputs=["voltage"],
        outputs=["current", "speed"],
        name="motor",
    )
    load, errors = [[0, 0, 0], [-0.005 * ROOT / NOMINAL["inertia"], 0, 0]], [[0, 0.02 * ROOT, 0], [0, 0, 0.1 * ROOT]]
    return plant.with_disturbances(load, output=errors).with_sensor_faults()


ranges = {"resistance": (0.95, 1.0, 1.1), "inertia": (0.0098, 0.01, 0.0102), "friction": (0.001, 0.002, 0.003)}
motors = rs.UncertainPlant.from_parameters(motor, ranges)
print(motors)

# %%
# Sampling and the loop
# ---------------------
# The bank runs on samples. Sampled matrices are not affine in the parameters, and the print says how much is left out: the
# narrower the ranges, the less. The controller is proportional, and acts one sample after the measurement: that delay is its
# state. (With an integrator a steady fault of the speed sensor would leave no trace, see :doc:`/limits`.)
dt = 0.01
controller = rs.StateSpace([[0.0]], [[0.0, -0.2]], [[1.0]], dt=dt, inputs=["current", "speed"], outputs=["voltage"])
loop = motors.discretize(dt).in_closed_loop(controller)
print(loop)

# %%
# The bank
# --------
# One estimator per sensor; the threshold of each is exceeded by no motor of the set, whatever the disturbances do. A monitor
# waits several times as long as ``settling`` after a start, so that it is worth being short.
bank = rs.design.robust_l1_bank(loop, settling=0.6, progress=False)
print(bank)

# %%
# Is that so for real motors too, with sampled matrices that are not affine? The exact thresholds of the eight motors at
# the corners, each alone, over those of the bank:
low, middle, high = (dict(zip(ranges, column, strict=True)) for column in zip(*ranges.values(), strict=True))
worst = dict.fromkeys(bank.thresholds, 0.0)
for corner in range(8):
    values = {name: (high if corner >> i & 1 else low)[name] for i, name in enumerate(ranges)}
    real = rs.UncertainPlant(motor(values).discretize(dt)).in_closed_loop(controller)
    for name, threshold in rs.design.certified_thresholds(bank, real).items():
        worst[name] = max(worst[name], float(threshold) / bank.thresholds[name])
print({name: f"{ratio:.4f}" for name, ratio in worst.items()})

# %%
# A recording
# -----------
# A motor with much friction, a load that comes and goes, and from 6 s on a speed sensor that reads
# too much, by the size from which the fault is certain to be seen.
rng = np.random.default_rng(0)
real = rs.UncertainPlant(motor({**middle, "friction": 0.003}).discretize(dt)).in_closed_loop(controller).nominal
steps, size = 1000, bank.smallest_faults["speed sensor"]
w = rng.uniform(-1, 1, (steps, 3)) / ROOT
w[:, 0] = np.sign(np.sin(2 * np.pi * np.arange(steps) / 150)) / ROOT
fault = np.where(np.arange(steps)[:, None] >= 600, size, 0.0) * [0, 1]
x, y = np.zeros(real.n_states), np.empty((steps, 2))
for k in range(steps):
    y[k] = real.C @ x + real.Dd @ w[k] + real.Df @ fault[k]
    x = real.A @ x + real.Bd @ w[k] + real.Bf @ fault[k]

found = rs.Monitor(bank).run(None, y)
print(found)
fig, axes = plt.subplots(2, 1, figsize=(8, 4.5), sharex=True, layout="constrained")
waits = dt * np.argmax(found.decided)
for i, (ax, (name, threshold)) in enumerate(zip(axes, bank.thresholds.items(), strict=True)):
    size_of = np.abs(found.residuals[:, i])
    ax.plot(found.time, size_of, lw=0.8)
    ax.axhline(threshold, color="C3", ls="--", lw=1, label="certified threshold")
    ax.axvspan(0, waits, color="0.9", lw=0)
    ax.axvline(6.0, color="0.4", lw=1)
    ax.set(ylabel=f"|residual|\n{name}", ylim=(0, 1.15 * max(size_of.max(), 1.5 * threshold)), xlim=(0, 10))
axes[0].legend(loc="upper right", fontsize=8)
axes[0].text(waits / 2, 0.93, "not judged", transform=axes[0].get_xaxis_transform(), ha="center", va="top", fontsize=8)
axes[0].set_title(f"Speed sensor off by {size:.2g} rad/s from 6 s on", fontsize=10)
axes[1].set(xlabel="time [s]")
plt.show()
