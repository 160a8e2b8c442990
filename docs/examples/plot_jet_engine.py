"""
Jet engine: naming the right sensor with a model that is slightly wrong
=======================================================================

Chen, Patton and Zhang (Int. J. Control 63(1), 1996) ask a practical question: the linear model of an engine is never
quite right, and its error looks like a fault. They treat the error as an unknown input, find out from data how it
enters, and design a filter that it cannot reach but in which faults still have directions of their own. This page goes
through their example from the matrices to the name of the faulty sensor, and computes every number that it shows.

The paper's Tables 1 and 2 come from an engine simulation that was never published, so they cannot be recomputed. Here the
engine is the paper's own second-order model, its eq. (32), which makes the same point.
"""

import matplotlib.pyplot as plt
import numpy as np

import residua as rs
from residua.decide import projection_distance
from residua.library import E_HAT, jet_engine, jet_engine_steady_state, simulate_jet_engine
from residua.plant import disturbance_from_steady_states, factor_disturbance

np.set_printoptions(precision=4, suppress=True, linewidth=110)

# %%
# The linear model
# ----------------
# Three states: the speeds of the low- and the high-pressure shaft and the fuel flow, all as relative deviations from an
# operating point. The first three of six measurements are the states, then come two pressures and a temperature.
engine = jet_engine(disturbances=False).without_faults("fuel actuator")
print(engine)
print("A =", engine.A, "B =", engine.B, "C =", engine.C, sep="\n")

# %%
# **A misprint.** The paper prints C(6,3) = 0.61299. With that number its own matrices T and K do not come out; of all
# entries of the third column in rows 4 to 6, only C(6,3) = 0.61199 explains both. The plant of the library has the
# corrected value; ``jet_engine(corrected=False)`` has the printed one. Both are compared below.
#
# How the error of the model enters
# ---------------------------------
# The unmodelled terms are taken to be all products of two states, x' = A x + B u + E d(x). At a steady state the left
# side is zero, so many steady states of the real engine give E by least squares. From 200 of them:
commands = np.linspace(-0.3, 0.3, 200)
states = np.array([jet_engine_steady_state(u) for u in commands])
E = disturbance_from_steady_states(engine.A, engine.B, states, commands)
print("E estimated =", E, sep="\n")
print(f"largest difference from the paper's matrix: {np.abs(E - np.array(E_HAT)).max():.1e}")

# %%
# (These steady states are those of the second-order model and free of noise. Recorded ones are neither; more of them and
# a wider range of commands then help.)
#
# Six unmodelled terms, but they enter in two directions only. Decoupling depends on the space that they span, so E is
# replaced by a factor with full column rank:
E1, decision = factor_disturbance(E, rtol=1e-6)
print("singular values:", decision.singular_values, "->", decision)
print("E1 =", E1, sep="\n")

# %%
# The paper's E1 is this one with both signs turned. Three sensors may fail. What can be told apart, whatever the method?
engine = engine.with_disturbances(E1)
result = rs.diagnosability(engine)
print(result)

# %%
# The observer that the error cannot reach
# ----------------------------------------
# z' = F z + T B u + K y with the estimate z + H y. The existence condition holds (last line above). With all poles at -3.
# More than one H decouples. Without ``H0`` the package takes the one that is smallest with evenly weighted outputs, which
# is the same in all units; the paper takes the smallest in the units that it uses, which is that of a zero ``H0``:
H0 = np.zeros((3, 6))
robust = rs.design.robust_detection_filter(engine, poles=[-3, -3, -3], H0=H0)
observer = robust.observer
print("H =", observer.H, "T =", observer.T, "K =", observer.K, sep="\n")

# %%
# Against the printed matrices, with the corrected and with the printed C(6,3):
T_printed = np.array([[0, 0, -0.1251], [0, 0, 0.0783], [0, 0, 1.0]])
H_printed = np.array(
    [[0.6117, -0.1170, 0, 0.3215, 0.3220, -0.1295], [-0.1170, 0.9382, 0, 0.0605, 0.0623, -0.1916], [0, 0, 0, 0, 0, 0]]
)
K_printed = np.array(
    [
        [-0.0708, 0.0443, 0.5658, 0.1400, 0.1531, 0.3540],
        [0.0443, -0.0277, -0.3540, -0.0876, -0.0958, -0.2215],
        [0.5658, -0.3540, -4.5229, -1.1193, -1.2239, -2.8297],
    ]
)
for corrected in (True, False):
    plant = jet_engine(corrected=corrected, disturbances=False).with_disturbances(E1)
    o = rs.design.unknown_input_observer(plant, poles=[-3, -3, -3], H0=H0)
    differences = [np.abs(a - b).max() for a, b in ((o.H, H_printed), (o.T, T_printed), (o.K, K_printed))]
    print(
        f"C(6,3) = {plant.C[5, 2]:.5f}: largest difference from the printed H {differences[0]:.1e}, "
        f"T {differences[1]:.1e}, K {differences[2]:.1e}"
    )

# %%
# What the design proves about itself. "Gain from disturbance" is what the model error still does to the residual, relative
# to the terms that have to cancel; the last lines say what decoupling costs.
print(robust.evidence)

# %%
# Two filters
# -----------
# For comparison, Beard's detection filter with the same poles. It trusts the linear model. In both filters the residual of
# a sensor fault stays in a plane, and the normalised projection distance (NPD) of a residual from that plane, 0 to 1,
# tells how well the fault explains it: the smallest one names the sensor.
beard = rs.design.detection_filter(engine, poles=[-3, -3, -3])
filters = {"Beard filter": beard, "robust filter": robust}


def signature(flt, j):
    """Return the plane of the paper's Definition 6 for sensor j: I_j, C k_1j and C h_j (the pinv does the rest)."""
    return np.column_stack([np.eye(6)[:, j], flt.plant.C @ flt.observer.K1[:, j], flt.plant.C @ flt.observer.H[:, j]])


def distances(flt, r):
    return [projection_distance(r, signature(flt, j)) for j in range(3)]


# %%
# First the ideal case, a linear engine: rows are the candidate sensors, columns the sensor that really failed, with a
# constant fault. The zero of each column is on the diagonal, so every fault is named. The second table uses the narrower
# space that holds for constant faults only, without C h_j; distances from wrong sensors become larger.
ideal = np.array([distances(robust, robust.steady_directions[fault]) for fault in engine.faults]).T
constant = np.array(
    [
        [projection_distance(robust.steady_directions[fault], signature(robust, j)[:, :2]) for j in range(3)]
        for fault in engine.faults
    ]
).T
for title, table in (("any time course", ideal), ("constant faults", constant)):
    print(f"NPD, {title}:")
    print(f"{'candidate':<17}  {'  '.join(engine.faults)}  (really failed)")
    for candidate, row in zip(engine.faults, table, strict=True):
        print(f"{candidate:<17}  {'  '.join(f'{abs(d):{len(f)}.5f}' for d, f in zip(row, engine.faults, strict=True))}")
assert np.allclose(ideal, [[0, 0.41584, 0.21139], [0.48443, 0, 0.20276], [0.85635, 0.70509, 0]], atol=1e-4)
assert np.allclose(constant, [[0, 0.94531, 0.87693], [0.96668, 0, 0.80697], [0.85635, 0.70509, 0]], atol=1e-4)

# %%
# The third sensor's space has dimension two, because no disturbance enters the third state and h_3 is zero. The paper's
# formula inverts a singular matrix there; the pseudoinverse with a rank tolerance does not.
#
# The real engine
# ---------------
# Now the second-order engine. The fuel command goes up by u = 0.2 at 1 s; at 7 s one of the sensors begins to read 2 % of
# its deviation too much.
dt = 0.005
time = dt * np.arange(2400)
command = np.where(time >= 1.0, 0.2, 0.0)


def record(fault=None):
    faults = {} if fault is None else {fault: np.where(time >= 7.0, 0.02, 0.0)}
    return simulate_jet_engine(command, dt=dt, faults=faults, relative=True)


cases = {fault: record(fault) for fault in (None, *engine.faults)}
residuals = {
    (name, fault): flt.run(run.u, run.y, dt=dt) for name, flt in filters.items() for fault, run in cases.items()
}

figure, axes = plt.subplots(2, 1, sharex=True, figsize=(8, 5), layout="constrained")
for ax, name in zip(axes, filters, strict=True):
    for fault in cases:
        label = "no fault" if fault is None else fault
        size = np.linalg.norm(residuals[name, fault], axis=1)
        ax.semilogy(time, np.maximum(size, 1e-16), label=label, linewidth=1.4)
    ax.set(title=name, ylabel="norm of the residual [–]", ylim=(1e-9, 1))
axes[0].legend(ncols=2, loc="lower right", fontsize=8)
axes[1].set_xlabel("time [s]")
plt.show()
leftover = np.linalg.norm(residuals["robust filter", None], axis=1).max()
print(f"robust filter without a fault: at most {leftover:.1e}")

# %%
# The Beard filter's residual jumps when the engine leaves its operating point, long before anything fails: that is the
# error of the linear model, and it is larger than the effect of two of the faults. The robust filter is blind to it; the
# small bump at 1 s, which dies out, is what sampling a continuous filter costs. Who is named, at the end of each recording?
width = max(len(fault) for fault in engine.faults)
print(f"{'':14} {'really failed':<{width}} {'|r|':>8}  {'  '.join(engine.faults)}  named")
named = {}
for name, flt in filters.items():
    for fault in cases:
        r = residuals[name, fault][-1]
        if np.linalg.norm(r) < 1e-12:
            print(f"{name:14} {fault or 'nothing':<{width}} {np.linalg.norm(r):8.1e}  rounding errors only: no alarm")
            continue
        npd = dict(zip(engine.faults, distances(flt, r), strict=True))
        named[name, fault] = min(npd, key=npd.get)
        mark = "" if named[name, fault] == fault else "  WRONG"
        values = "  ".join(f"{value:{len(candidate)}.5f}" for candidate, value in npd.items())
        print(f"{name:14} {fault or 'nothing':<{width}} {np.linalg.norm(r):8.5f}  {values}  {named[name, fault]}{mark}")
for name in filters:
    right = sum(named[name, fault] == fault for fault in engine.faults)
    print(f"{name}: {right} of {len(engine.faults)} sensors named")
assert all(named["robust filter", fault] == fault for fault in engine.faults)

# %%
# The Beard filter names the same sensor when nothing has failed at all: where it is right, it is so by chance. As a
# picture:
figure, axes = plt.subplots(1, 2, figsize=(10, 3.4), sharey=True, layout="constrained")
for ax, (name, flt) in zip(axes, filters.items(), strict=True):
    for j, candidate in enumerate(engine.faults):
        heights = [distances(flt, residuals[name, fault][-1])[j] for fault in engine.faults]
        ax.bar(np.arange(3) + 0.27 * (j - 1), heights, width=0.25, label=candidate)
        for i, fault in enumerate(engine.faults):
            if named[name, fault] == candidate:
                tick = "✓" if candidate == fault else "✗"
                ax.annotate(tick, (i + 0.27 * (j - 1), heights[i]), ha="center", va="bottom", fontsize=12)
    ax.set_xticks(range(3), [f.removesuffix(" sensor") for f in engine.faults])
    ax.set(title=name, xlabel="sensor that really failed", ylim=(0, 1.1))
axes[0].set_ylabel("distance from the signature, NPD [–]")
figure.legend(*axes[0].get_legend_handles_labels(), title="candidate", loc="outside right upper")
plt.show()

# %%
# As a monitor
# ------------
# The same filter with a threshold of half the smallest effect that the linear model predicts, running as it would in
# operation. The monitor samples the continuous filter itself.
fault = "n_high sensor"
sizes = {f: 0.02 * float((engine.C @ jet_engine_steady_state(0.2))[j]) for j, f in enumerate(engine.faults)}
effects = [abs(sizes[f]) * np.linalg.norm(robust.steady_directions[f]) for f in engine.faults]
monitor = rs.Monitor(robust, test=rs.decide.NormThreshold(threshold=0.5 * min(effects), whiten="none"), dt=dt)
diagnosis = monitor.run(cases[fault].u, cases[fault].y, time=cases[fault].time, source=f"{fault}, 2 %")
print(diagnosis)
print(monitor.run(cases[None].u, cases[None].y, time=cases[None].time))

# %%
# ``residua demo jet-engine`` runs this on the command line and writes a report page with all cases.
