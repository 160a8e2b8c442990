"""
Faults as directions
====================

A detection filter is an observer whose gain is chosen so that each fault pushes the residual along a line of its own,
whatever its time course. Which component failed is then a question of geometry. This page works through Example 3A of
Gertler's survey (Automatica 27(4), 1991): two residuals, two faults, and a picture of it.
"""

import matplotlib.pyplot as plt
import numpy as np

import residua as rs
from residua.linear import invariant_zeros

plant = rs.library.gertler()
print(plant)
print(rs.diagnosability(plant))

# %%
# Poles, and one that cannot be chosen
# ------------------------------------
# Three states, two measurements. White and Speyer's design gives each fault an eigenvector of its own. The faults
# together have an invariant zero in the plant, and no gain moves it: it becomes the third pole of every filter that
# keeps the directions apart. Its position decides whether such a filter is stable.
zeros = invariant_zeros(plant.A, plant.Bf, plant.C)
print("invariant zeros of (A, F, C):", zeros.zeros.real.round(12))

flt = rs.design.detection_filter(plant, poles={"p1": [0.25], "p2": [0.3]})
print("poles:", flt.evidence.poles.real.round(9), " fixed:", flt.evidence.fixed_poles.real.round(9))
print("K =")
print(flt.observer.K.round(9) + 0.0)
assert np.allclose(flt.observer.K, [[0.1, -0.05], [0.1, 0.05], [-0.2, 0.4]], atol=1e-10)

# %%
# That is the gain printed in the paper. The directions are (2, 1) and (1, 2), here with unit length, and each fault
# reaches the residual through a first-order lag, 1/(z - 0.25) and 1/(z - 0.3):
for name, direction in flt.directions.items():
    print(f"{name}: {direction.round(4)}, proportional to {(direction / np.abs(direction).min()).round(6)}")
z = np.exp(0.4j)
response = flt.internal_form().evaluate([z])[0]
assert np.allclose(response[:, 0], np.array([2, 1]) / (z - 0.25))
assert np.allclose(response[:, 1], np.array([1, 2]) / (z - 0.3))

# %%
# On the line, whatever the time course
# -------------------------------------
# Three runs with the same input: a fault p1 that comes and goes, a fault p2 that grows, and both at once.
steps = np.arange(120)
u = np.sign(np.sin(steps / 9.0))[:, None]
p1 = np.where(steps > 20, np.sin(steps / 6.0), 0.0)
p2 = np.clip((steps - 40) / 60.0, 0.0, None)
cases = {"p1 alone": (p1, 0 * p2), "p2 alone": (0 * p1, p2), "both at once": (p1, p2)}

system = plant.system(("control", "fault"))
residuals = {}
for title, faults in cases.items():
    y = system.simulate(np.column_stack([u, *faults]))
    residuals[title] = flt.run(u, y)

figure, axes = plt.subplots(1, 3, figsize=(10, 3.7), sharex=True, sharey=True, layout="constrained")
for ax, (title, r) in zip(axes, residuals.items(), strict=True):
    for (name, direction), colour in zip(flt.directions.items(), ("tab:blue", "tab:orange"), strict=True):
        ax.axline((0, 0), tuple(direction), color=colour, linewidth=1, label=f"signature of {name}")
    ax.plot(*r.T, ".-", color="0.25", linewidth=0.6, markersize=3, label="residual")
    ax.set(title=title, xlabel="residual r y1 [–]", xlim=(-4.5, 4.5), ylim=(-4.5, 4.5), aspect="equal")
axes[0].set_ylabel("residual r y2 [–]")
axes[0].legend(loc="lower right", fontsize=8)
plt.show()

for title, name in (("p1 alone", "p1"), ("p2 alone", "p2")):
    r, d = residuals[title], flt.directions[name]
    off = np.linalg.norm(r - np.outer(r @ d, d), axis=1).max()
    print(f"{title}: residual up to {np.linalg.norm(r, axis=1).max():.3f}, off its line by at most {off:.1e}")

# %%
# Both at once, taken apart again
# -------------------------------
# Two independent directions span the plane, so the residual of two simultaneous faults has one component along each:
# every component is one of the faults, delayed by its lag.
D = np.column_stack([flt.directions[name] for name in plant.faults])
parts = np.linalg.solve(D, residuals["both at once"].T).T
gain = [np.linalg.norm(flt.steady_directions[name]) for name in plant.faults]

figure, axes = plt.subplots(2, sharex=True, figsize=(8, 4.2), layout="constrained")
for ax, name, part, size, truth in zip(axes, plant.faults, parts.T, gain, (p1, p2), strict=True):
    ax.plot(steps, truth, color="0.6", label=f"{name}, as it was")
    ax.plot(steps, part / size, ".", markersize=3, label="from the residual")
    ax.set_ylabel(f"{name} [–]")
    ax.legend(loc="upper left", fontsize=8)
axes[-1].set_xlabel("sample")
plt.show()

# %%
# With more faults than measurements this is no longer possible for all of them at once; the design then spreads the
# faults over several filters (``flt.members``), which run as one.
