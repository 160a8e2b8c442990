"""
A circuit with algebraic equations
==================================

Kirchhoff's laws give differential equations for coils and capacitors and algebraic ones for everything between them. Put
down as they are, the plant is ``E x' = A x + B u`` with a singular ``E``. This page takes such a plant as it is: what its
structure says, how it is sampled, and an observer that only singular plants have, one without dynamics.
"""

import matplotlib.pyplot as plt
import numpy as np

import residua as rs
from residua.linear import consistent_state, descriptor_observability, simulate_descriptor, weierstrass_form

plant = rs.library.ladder_circuit()
print(plant)
print("states:", plant.states, " E = diag", np.diag(plant.E))

# %%
# What the equations determine
# ----------------------------
# The Weierstrass form separates what moves from what follows at once: two finite poles, and an algebraic part. Its index,
# 1, says that no derivative of the source is needed. Not every state is possible, either: the node voltages must
# carry the currents that arrive.
form = weierstrass_form(plant.A, plant.E)
print("index:", form.index, "  poles [1/s]:", np.sort_complex(form.poles).round(2))
print("observable:", descriptor_observability(plant.A, plant.C, plant.E))

system = plant.system("control")
at_rest = consistent_state(system, [0.5, 2.0, 0.0, 0.0], [5.0])
print("given (0.5 A, 2 V, 0 V, 0 V), consistent:", bool(at_rest))
print("right after the jump:", dict(zip(plant.states, at_rest.state.round(3).tolist(), strict=True)))

# %%
# Sampling eliminates the node voltages, exactly. The currents and voltages with an equation of their own stay; every
# transfer function, also that of a fault in an algebraic equation, stays as well.
h = 2e-4
sampled = plant.discretize(h)
print("sampled:", sampled.states)
u = 5.0 * (np.arange(400) % 200 < 100)[:, None]
whole = simulate_descriptor(system, u, x0=at_rest.state, dt=h)
start = [whole.states[0, plant.states.index(name)] for name in sampled.states]
print("same outputs:", np.allclose(sampled.system("control").simulate(u, start), whole.outputs))

# %%
# An observer without dynamics
# ----------------------------
# A perfect observer has a gain ``K`` for which ``det(sE - A - KC)`` is a constant: it has no poles. Its estimate is the
# state, from the first samples on, whatever the initial state was; an observer with poles has to converge. Here both
# are given the current of the coil alone, and asked for the voltage of the capacitor at the other end.
steady = plant.without_disturbances()
K = rs.design.perfect_observer(steady).K
values = [np.linalg.det(s * plant.E - plant.A - K @ plant.C) for s in (0.0, 100.0, -40.0 + 300.0j)]
print("det(sE - A - KC) is the same at three points:", np.allclose(values, values[0]))

known = sampled.without_disturbances()
one_sensor = rs.design.perfect_observer(known, outputs=["i"], least_order=True)
luenberger = rs.design.luenberger_observer(known, outputs=["i"], poles=np.exp(np.array([-150.0, -200.0]) * h))
print("the perfect observer is", one_sensor.derivatives, "step late")

# %%
# The source of this plant has an unknown ripple. Driven by all three sensors a perfect observer is told nothing about it,
# and estimates it along the way.
t = h * np.arange(400)
ripple = 0.5 * np.sin(2 * np.pi * 100 * t)[:, None]
both = simulate_descriptor(plant.system(("control", "disturbance")), np.hstack([u, ripple]), dt=h, x0=at_rest.state)
perfect = rs.design.perfect_observer(sampled)
column = sampled.states.index("vc")
late = perfect.derivatives
missed = perfect.estimate(u, both.outputs)[late:, column] - both.states[: len(t) - late, plant.states.index("vc")]
print(f"{late} step late, and off by less than 1e-9 V from then on:", np.abs(missed).max() < 1e-9)

figure, axes = plt.subplots(2, sharex=True, figsize=(8, 4.6), layout="constrained")
axes[0].plot(1e3 * t, whole.states[:, plant.states.index("vc")], color="0.6", linewidth=4, label="capacitor voltage")
axes[0].plot(1e3 * t, luenberger.estimate(u, whole.outputs)[:, column], color="tab:orange", label="Luenberger observer")
axes[0].plot(1e3 * t, one_sensor.estimate(u, whole.outputs)[:, column], color="tab:blue", label="perfect observer")
axes[0].set(ylabel="v$_c$ [V]", ylim=(-0.5, 6.5))
axes[0].legend(loc="upper right", fontsize=8)
axes[1].plot(1e3 * t, ripple, color="0.6", linewidth=4, label="ripple of the source")
axes[1].plot(1e3 * t, perfect.estimate_disturbances(u, both.outputs), color="tab:blue", label="estimated")
axes[1].set(xlabel="time [ms]", ylabel="ripple [V]", ylim=(-1, 1))
axes[1].legend(loc="upper right", fontsize=8)
plt.show()

# %%
# Faults become polynomials
# -------------------------
# Without dynamics the residual is a differential polynomial of the faults: so much of the fault, so much of its
# derivative, and nothing afterwards. On the smallest singular plant there is, with a given gain,
# r = f'/3 for the actuator and r = -2/3 f - 4/3 f' for the sensor:
small = rs.Plant([[1, 2], [3, 4]], [[1], [1]], [[1, 1]], E=[[1, 0], [0, 0]], inputs=["u"], outputs=["y"])
small = small.with_actuator_faults().with_sensor_faults()
for name, coefficients in rs.design.perfect_observer(small, K=[[1], [-4]]).polynomial().items():
    print(name, "coefficients of f, f':", coefficients.ravel().round(6) + 0.0)

# %%
# In the circuit the first residual takes no derivative: it is the sum of the currents at node a, which a leak at node b
# does not touch. The second reads the rest. The ripple moves neither. Here it is the continuous observer, which passes
# everything through lags of 1000 rad/s. (An error of the current sensor looks
# like a leak at node a: with the source unknown, nothing else tells of the current.)
generator = rs.design.perfect_observer(plant, bandwidth=1000.0).residual_generator()
cases = {"leak a": 0.2, "leak b": 0.2}
figure, axes = plt.subplots(1, 2, sharex=True, sharey=True, figsize=(8, 3), layout="constrained")
for ax, (name, size) in zip(axes, cases.items(), strict=True):
    faults = np.zeros((400, len(plant.faults)))
    faults[200:, plant.faults.index(name)] = size
    v = np.hstack([u, ripple, faults])
    y = sampled.system(("control", "disturbance", "fault")).simulate(v)
    ax.plot(1e3 * t, generator.run(u, y, dt=h), ".", markersize=3, label=generator.residuals)
    ax.axvline(1e3 * t[200], color="0.7", linewidth=1)
    ax.set(title=name, xlabel="time [ms]")
axes[0].set_ylabel("residuals [–]")
axes[0].legend(loc="lower left", fontsize=8)
print("does the first residual see it?", dict(zip(plant.faults, generator.structure[0].tolist(), strict=True)))
plt.show()

# %%
# The price
# ---------
# Derivatives amplify noise. The continuous observer passes everything through lags of one bandwidth, so that its estimate
# is the equally filtered state; the bandwidth is what delay is bought with.
bandwidths = np.geomspace(50.0, 50e3, 13)
observers = [rs.design.perfect_observer(plant, bandwidth=float(w)) for w in bandwidths]
gains = [o.evidence.conditions["noise gain, outputs to estimate (peak)"] for o in observers]
figure, ax = plt.subplots(figsize=(6, 3), layout="constrained")
ax.loglog([1e3 * o.delay for o in observers], gains, "o-", color="tab:blue", markersize=4)
ax.set(xlabel="delay of the estimate [ms]", ylabel="largest gain from\nmeasurement to estimate [–]")
plt.show()

# %%
# Where a mode stays unseen there is no such observer, and the refusal says where:
try:
    rs.design.perfect_observer(plant.with_disturbances({"load current": {"vb": -1.0}}))
except rs.errors.DesignError as error:
    print(error)
