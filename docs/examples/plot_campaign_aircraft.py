"""
A campaign for an aircraft under its controller
===============================================

An aircraft never flies without its controller, and the controller hides faults: it steers against them, and a sensor that is
wrong misleads it. A campaign therefore runs with the controller in the loop, and with faults that are no constant offsets: an
actuator that loses effectiveness, a sensor that sticks, one that drifts, one that oscillates. Then two tests are compared,
on the same draws of the noise.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.linalg import solve_discrete_are

import residua as rs
from residua.validate import Scenario, drift, loss_of_effectiveness, oscillation, stuck_at

# %%
# Aircraft and controller
# -----------------------
# The model of an aircraft that takes off vertically, at 20 Hz. Gusts shake its four states, and its three sensors have noise.
# The controller is a Kalman filter with state feedback (LQG).
aircraft = rs.library.vtol().discretize(0.05)
aircraft = aircraft.with_noise(process=[1e-3, 1e-3, 1e-4, 1e-5], measurement=[0.02, 0.02, 0.002])
print(aircraft)


def regulator(plant):
    """Return the LQG controller from the sensors to the actuators, for equal weights."""
    cost = solve_discrete_are(plant.A, plant.B, np.eye(plant.n_states), np.eye(len(plant.inputs)))
    K = np.linalg.solve(np.eye(len(plant.inputs)) + plant.B.T @ cost @ plant.B, plant.B.T @ cost @ plant.A)
    error = solve_discrete_are(plant.A.T, plant.C.T, plant.process_noise, plant.measurement_noise)
    L = np.linalg.solve(plant.C @ error @ plant.C.T + plant.measurement_noise, plant.C @ error @ plant.A.T).T
    return rs.StateSpace(
        plant.A - plant.B @ K - L @ plant.C, L, -K, dt=plant.dt, inputs=plant.outputs, outputs=plant.inputs
    )


controller = regulator(aircraft)

# %%
# The pilot asks for a manoeuvre now and then: both actuators are moved, one after the other, on top of what the controller
# does. A weak actuator can only be seen when it has something to do.
time = aircraft.dt * np.arange(1200)
pilot = np.column_stack([np.sin(2 * np.pi * time / 20) > 0.8, np.sin(2 * np.pi * time / 20) < -0.8]).astype(float)

# %%
# Two monitors with one promise
# -----------------------------
# Both look at the same innovations of a Kalman filter: one at each sample by itself, the other at their exponentially
# weighted average. Both are designed for one false alarm in 2,000 samples, 100 s.
kalman = rs.design.kalman_filter(aircraft)
isolation = rs.decide.Directional(signature="steady")
single = rs.Monitor(kalman, test=rs.decide.NormThreshold(persistence=1, false_alarm_rate=1 / 2000), isolate=isolation)
average = rs.Monitor(kalman, test=rs.decide.EWMA(weight=0.1, mean_time_between_false_alarms=2000), isolate=isolation)
for monitor in (single, average):
    print(monitor.norm_test.basis)

# %%
# Nothing has failed in these 400 minutes; the false alarms of both come as often as designed:
watching = {"controller": controller, "inputs": pilot, "samples": 1200}
for name, monitor in (("single samples", single), ("weighted average", average)):
    quiet = rs.validate.campaign(monitor, runs=400, seed=1, **watching)
    between = quiet.time_between_false_alarms()
    print(f"{name}: designed 100 s between false alarms, measured {between} s")
    assert between.low <= 100 <= between.high

# %%
# Faults that are no steps
# ------------------------
# All begin at 20 s. A sensor that sticks stays at what it read last; an actuator with a loss of 0.2 does 80 % of
# what it is told to.
scenarios = [
    Scenario("cyclic actuator", loss_of_effectiveness(at=20), size=[0.1, 0.2, 0.4]),
    Scenario("collective actuator", loss_of_effectiveness(at=20), size=[0.1, 0.2, 0.4]),
    Scenario("v_vertical sensor", stuck_at(at=20)),
    Scenario("pitch sensor", drift(slope=0.01, at=20), size=[0.1, 0.2, 0.4]),
    Scenario("v_horizontal sensor", oscillation(period=2.0, at=20), size=[0.05, 0.1, 0.2]),
]
first = rs.validate.campaign(single, scenarios, runs=150, seed=2, within=20, **watching)
second = rs.validate.campaign(average, scenarios, runs=150, seed=2, within=20, **watching)
print(second.table())

# %%
# What the two see, side by side: each bar with its 95 % interval, the line is what a false alarm alone would have counted.
figure, ax = plt.subplots(figsize=(8, 5.5), layout="constrained")
rows = np.arange(len(second.cases))
for place, (name, made) in enumerate([("single samples", first), ("weighted average", second)]):
    seen = [made.detected(k) for k in range(len(made.cases))]
    values = np.array([one.value for one in seen])
    errors = np.array([[one.value - one.low for one in seen], [one.high - one.value for one in seen]])
    ax.barh(rows - 0.2 + 0.4 * place, values, 0.38, xerr=errors, label=name, capsize=2)
ax.axvline(second.by_chance(0).value, color="k", linewidth=1, linestyle=":", label="by chance")
ax.set_yticks(
    rows, [case.name.replace("(at=20)", "").replace("at=20, ", "").replace(", at=20", "") for case in second.cases]
)
ax.invert_yaxis()
ax.set(xlabel="detected within 20 s [share of the runs]", xlim=(0, 1.02))
figure.legend(loc="outside lower center", ncols=3)
plt.show()

# %%
# Which one is better
# -------------------
# Run for run, with the same noise: how many runs only one of them saw, and whether that can be chance.
print(second.compare(first).table())

# %%
# The average sees every fault at least as often, weak ones far more often. Who is named, where an alarm is raised?
print(second.confusion())

# %%
# The two actuators are often taken for each other: both pitch the aircraft, and their directions are close together. A drift
# of the pitch sensor is seen last: the controller follows the wrong sensor, and the filter takes much of the drift for a
# movement of the aircraft.
#
# Designed against measured delay
# -------------------------------
# The equations behind the threshold give a delay for a step that is settled in the residual. Steps of each fault that move
# the residual by one standard deviation once it is settled, with the measured mean delay beside the designed one:
steps, length = [], 600
for fault, direction in kalman.steady_directions.items():
    size = 1.0 / float(np.linalg.norm(direction @ average.norm_test.metric))
    steps.append(Scenario(fault, rs.validate.step(at=10), size=size))
designed = average.test.delay(average.threshold, kalman.n_residuals, shift=1.0) * aircraft.dt
made = rs.validate.campaign(average, steps, runs=300, samples=length, seed=3, controller=controller, inputs=0.0)
print(f"designed: {designed:.2f} s")
for k, case in enumerate(made.cases):
    print(f"{case.name:45} {made.delay(k).mean(seed=0)} s")

# %%
# The design holds for a residual that is settled. A fault of an actuator builds up in the residual over a second, and is
# later by that; the pitch sensor's hits it at more than its settled size at once, and is seen earlier.
