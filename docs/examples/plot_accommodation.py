"""
Flying on with a fault
======================

Once a fault is estimated it can be lived with: a control input compensates a faulty actuator, and a controller reads what
a faulty sensor should read. Here both on the aircraft of Sueur, in closed loop, with and without.
"""

import matplotlib.pyplot as plt
import numpy as np
import scipy.linalg

import residua as rs

aircraft = rs.library.vtol()
A, B = aircraft.A, aircraft.B
X = scipy.linalg.solve_continuous_are(A, B, np.diag([1.0, 1.0, 0.1, 1.0]), np.eye(2))
feedback = B.T @ X  # a linear-quadratic regulator of the state
print("poles under exact state feedback:", np.sort(np.linalg.eigvals(A - B @ feedback).real).round(2))

h = 0.002
times = np.arange(round(10 / h) + 1) * h


def run(loop, fault, course):
    """Return the outputs of a closed loop, from rest, with one fault."""
    v = np.zeros((len(times), loop.n_inputs))
    v[:, loop.inputs.index(fault)] = course
    return dict(zip(loop.outputs, loop.discretize(h).simulate(v).T, strict=True))


# %%
# An actuator that is off
# -----------------------
# From the second second the collective pitch is off by 2. The feedback alone only softens what that does; with the
# estimate subtracted from the command, the aircraft returns to where it was.
actuators = aircraft.faults[:2]
estimator = rs.design.fault_estimator(aircraft, faults=actuators, poles=[-20, -25, -100 / 3, -50], bandwidth=40)
compensation = rs.design.compensation_gain(aircraft, actuators)
print("what no input can undo:", {name: round(left, 6) for name, left in compensation.left.items()})
course = np.where(times >= 2, 2.0, 0.0)
runs = {
    "without": run(rs.design.closed_loop(aircraft, estimator, feedback, compensate=False), actuators[0], course),
    "with compensation": run(rs.design.closed_loop(aircraft, estimator, feedback), actuators[0], course),
}

figure, axes = plt.subplots(3, sharex=True, figsize=(8, 6), layout="constrained")
for label, signals in runs.items():
    axes[0].plot(times, signals["v_vertical"], label=label)
    axes[1].plot(times, signals["pitch"])
    axes[2].plot(times, signals["control collective"])
axes[2].plot(times, -course, "k:", label="the fault, negated")
for ax, text in zip(axes, ("v_vertical [kn]", "pitch [deg]", "collective [–]"), strict=True):
    ax.set_ylabel(text)
axes[0].legend(loc="center right")
axes[2].legend(loc="upper right")
axes[2].set_xlabel("time [s]")
plt.show()

for label, signals in runs.items():
    print(
        f"{label:<18} v_vertical at 10 s: {abs(signals['v_vertical'][-1]):.4f} kn, "
        f"largest {np.abs(signals['v_vertical']).max():.3f} kn"
    )
assert abs(runs["with compensation"]["v_vertical"][-1]) < 1e-3

# %%
# What remains is a short kick: the fault acts until the estimate has caught up with it, after a lag of 25 ms.
#
# Estimation changes nothing else. Its poles are added to those of the feedback, which stay where they are:
loop = rs.design.closed_loop(aircraft, estimator, feedback)
print("real parts of the poles of the loop:", np.sort(loop.poles().real).round(1))

# %%
# A sensor that lies
# ------------------
# From the second second the horizontal velocity reads 5 too high. An ordinary observer believes it, and the feedback
# follows: the aircraft really changes its velocity. The fault estimator takes that sensor's fault for unknown, and the
# feedback on its state never notices.
fault = "v_horizontal sensor"
course = np.where(times >= 2, 5.0, 0.0)
ordinary = rs.design.luenberger_observer(aircraft, poles=[-20, -25, -100 / 3, -50])
own = rs.design.fault_estimator(aircraft, faults=fault, poles=[-20, -25, -100 / 3, -50])
runs = {
    "ordinary observer": run(rs.design.closed_loop(aircraft, ordinary, feedback), fault, course),
    "virtual sensor": run(rs.design.closed_loop(aircraft, own, feedback), fault, course),
}

figure, axes = plt.subplots(3, sharex=True, figsize=(8, 6), layout="constrained")
for label, signals in runs.items():
    axes[0].plot(times, signals["state v_horizontal"], label=label)
    axes[1].plot(times, signals["state pitch"])
    axes[2].plot(times, signals["v_horizontal"])
for ax, text in zip(axes, ("true v_horizontal [kn]", "true pitch [deg]", "measured\nv_horizontal [kn]"), strict=True):
    ax.set_ylabel(text)
axes[0].legend(loc="center right")
axes[2].set_xlabel("time [s]")
plt.show()

for label, signals in runs.items():
    print(f"{label:<18} true v_horizontal off by up to {np.abs(signals['state v_horizontal']).max():.4f} kn")
estimate = runs["virtual sensor"][f"estimate {fault}"]
print(f"estimated fault at 10 s: {estimate[-1]:.6f} kn")
assert np.abs(runs["virtual sensor"]["state v_horizontal"]).max() < 1e-9

# %%
# The same in sampled time
# ------------------------
# A controller runs on samples. Everything above is there for the sampled aircraft too; the estimate of the actuator's fault
# is then exact, one sample late.
sampled = aircraft.discretize(0.02)
K = scipy.linalg.solve_discrete_are(sampled.A, sampled.B, np.diag([1.0, 1.0, 0.1, 1.0]), np.eye(2))
K = np.linalg.solve(np.eye(2) + sampled.B.T @ K @ sampled.B, sampled.B.T @ K @ sampled.A)
digital = rs.design.fault_estimator(sampled, faults=actuators, margin=10)
steps = np.arange(500)
for label, compensate in (("without", False), ("with compensation", True)):
    loop = rs.design.closed_loop(sampled, digital, K, compensate=compensate)
    v = np.zeros((len(steps), loop.n_inputs))
    v[:, loop.inputs.index(actuators[0])] = np.where(steps >= 100, 2.0, 0.0)
    out = loop.simulate(v)
    print(f"{label:<18} v_vertical at 10 s: {abs(out[-1, 1]):.4f} kn, largest {np.abs(out[:, 1]).max():.3f} kn")
