"""
Observers and parity relations are one: Gertler's examples
==========================================================

Parity relations come from the input-output equations of a plant, diagnostic observers from its states. Gertler's survey
of 1991 shows that both lead to the same residuals, up to poles, and works one plant through by four methods. This page does
the same with this package, computes everything that it states, and says where the printed numbers are wrong.
"""

import matplotlib.pyplot as plt
import numpy as np

import residua as rs
from residua.errors import DesignError
from residua.linear import PolynomialMatrix, primitive_part, shortest_left_null_vectors

# %%
# Example 1: what coding sets are worth
# -------------------------------------
# Three sets of residuals (rows) for three faults (columns). In the first, two faults have the same code. In the second all
# codes differ, but a fault that is too small to fire all of its residuals is taken for another one. In the third that cannot
# happen.
for rows in (["110", "111", "111"], ["110", "101", "111"], ["110", "101", "011"]):
    print(rs.coding.CodingSet.of(rows), end="\n\n")

# %%
# Example 2: one residual by four methods
# ---------------------------------------
# The plant has three states, two outputs, and two faults that enter the state: ``p1`` shall be ignored, ``p2`` be seen.
plant = rs.library.gertler()
io = rs.InputOutputModel.from_plant(plant)
print(io)

# %%
# These are the equations of the paper, whose zeros are rounded: .433 is 13/30, .864 is 19/22. They may be typed in as well.
# Two equations of order two are of order three together: the pole 0.5 is one state that both outputs see.
typed = rs.InputOutputModel([[1, -0.9, 0.2], [1, -1.4, 0.45]], [[[1.5, -0.65]], [[1.1, -0.95]]]).with_faults(
    {"p1": [[2, -0.9], [1, -0.9]], "p2": [[1, -0.4], [2, -1.4]]}
)
print("states of its smallest realisation:", typed.to_plant().n_states)
z = np.exp(1j * np.linspace(0.1, 3, 30))
assert np.allclose(typed.transfer(z), io.transfer(z), atol=1e-9)

# %%
# A. A structured parity equation
# ~~~~~~~~~~~~~~~~~~~~~~~~~~~~~~~
# A row of polynomials ``w`` with ``w g = 0``, where ``g`` is what ``p1`` does to the two equations. There is one of degree one,
# w = [z - 0.9, -2 (z - 0.45)] as in the paper:
p1, p2 = (io.Gf.select(columns=[j]) for j in range(2))
found = shortest_left_null_vectors(p1, most=3)
w = found.vectors[0] / found.vectors[0, 1, 0]
print("w, highest power first:", (w[::-1].T.round(9) + 0.0).tolist())

# %%
# Multiplied out, the relation is of order three; all of it has the factor z - 0.5, which the paper divides out without a
# word. The design does the same, and says so.
whole = primitive_part(PolynomialMatrix(w[:, None]) @ io.H.beside(-io.G, p2))
print("order", whole.matrix.degree + len(whole.roots), "with the common root", whole.roots.real.round(9))

A = rs.design.structured_parity(io, ["01"]).generator  # one row: p1 ignored, p2 seen
print(A.relations)
print("p2 enters by", (A.relations.fault_rows.coefficients[::-1, 0, 1].round(9) + 0.0).tolist(), "(powers z^2, z, 1)")

# %%
# So z² r* = (0.7 z - 0.54) u + (z - 0.4)(z - 0.9) y1 - 2 (z - 0.45)(z - 0.9) y2 = -3 (z - 0.6) p2. The printed "realizable form"
# has the opposite sign at y2; with it, the residual would not even be zero while nothing fails.

# %%
# B. Chow and Willsky's scheme
# ~~~~~~~~~~~~~~~~~~~~~~~~~~~~
# Three samples of both outputs are Y = R x + Q U. The parity vector is orthogonal to R and to what p1 adds; it is unique, and
# the one printed.
R, Q = rs.design.chow_willsky_matrices(plant, 2)
B = rs.design.parity_relations(plant, insensitive_to="p1")
vector = B.relations.parity_vectors[0]
print("w =", vector.round(9))
assert np.allclose(vector @ R, 0, atol=1e-12)
assert np.allclose(vector @ Q["fault"][:, 0::2], 0, atol=1e-12)

# %%
# The paper calls its relation identical with A; as printed it is the negative of A's.

# %%
# C. Eigenstructure assignment
# ~~~~~~~~~~~~~~~~~~~~~~~~~~~~
# A diagnostic observer whose gain makes the column of p1 a right eigenvector of A - K C, with eigenvalue 0.
C = rs.design.eigenstructure_assignment(plant, side="right", insensitive_to="p1", poles=[0, 0.25, 0.3])
print("s =", (C.observer.W / C.observer.W[0, 0]).round(9), " poles:", np.sort(C.evidence.poles.real).round(9) + 0.0)
print("K =", *C.observer.K.round(5).tolist(), sep="\n  ")

# %%
# K is not unique: with f the column of p1, ``K + f X s`` gives the same residual and the same poles, whatever X. The printed K
# is not of this family, and its poles are not those that were chosen:
printed = np.array([[1, -1.6], [1.028, -1.556], [-0.289, 0.578]])
print("poles of the printed K:  ", np.sort(np.linalg.eigvals(plant.A - printed @ plant.C).real).round(3) + 0.0)
corrected = np.array([[1, -8 / 5], [67 / 60, -26 / 15], [-13 / 30, 13 / 15]])
print("poles of the corrected K:", np.sort(np.linalg.eigvals(plant.A - corrected @ plant.C).real).round(9) + 0.0)
by_gain = rs.residual_generator_from_observer(plant, gain=corrected, weight=[[1, -2]])
print(C.equivalent_to(by_gain))

# %%
# It is the exact gain for a third pole of 0.5 instead of 0.3. With the corrected one, 1.117 for 1.028 and so on, the input-output
# form that the paper prints is exact. From the left, rows of C as left eigenvectors, no such observer exists, as the paper says:
try:
    rs.design.eigenstructure_assignment(plant, side="left", insensitive_to="p1")
except DesignError as error:
    print(error)

# %%
# D. An unknown input observer
# ~~~~~~~~~~~~~~~~~~~~~~~~~~~~
# s(t+1) = M s + J u + N y, r = Ls s + Ly y, given in the paper as numbers (the second matrix printed as T is N, and "(z.-3)" is
# z - 0.3). With p1 as a disturbance of the plant they are checked before they become a generator: s = T x for any input, and
# no p1 in it.
disturbed = plant.faults_as_disturbances("p1")
D = rs.residual_generator_from_observer(
    disturbed,
    M=[[0.25, 0], [0, 0.3]],
    T=[[6.5, -6.5, -4], [6, -6, -3]],
    N=[[0.975, -2.6], [0.6, -1.8]],
    J=[[-3.65], [-3.3]],
    Ls=[[-2, 2]],
    Ly=[[1, -2]],
)
print(rs.design.general_form(D))

# %%
# All four are one
# ~~~~~~~~~~~~~~~~
# ``equivalent_to`` tells whether two generators are the same up to a transformation, and which one it is. z² over
# (z - 0.25)(z - 0.3) is all that lies between a parity relation and an observer; dividing by poles is how to get there.
for name, other in {"B": B, "C": C, "D": D}.items():
    print(f"A and {name}:", A.equivalent_to(other))
print("A with the poles 0.25 and 0.3, and D:", A.relations.with_poles([0.25, 0.3]).equivalent_to(D))

# %%
# The same in time: a random input throughout, p1 from 5 to 20 s, p2 from 30 s on. The equations as they stand answer to both
# faults. The four do not see p1. To p2 they begin alike; a moving average has settled after two samples, the observers take a few
# more, and settle at another size.
steps = np.arange(51)
u = np.random.default_rng(3).standard_normal((len(steps), 1))
faults = np.column_stack([(steps >= 5) & (steps < 20), steps >= 30]).astype(float)
y = plant.system(("control", "fault")).simulate(np.hstack([u, faults]))
primary = rs.design.primary_residuals(io)

designs = {"A parity equation": A, "B Chow-Willsky": B, "C eigenstructure": C, "D unknown input observer": D}
fig, (top, bottom) = plt.subplots(2, 1, sharex=True, figsize=(8, 5.6), layout="constrained")
for name, r in zip(("e1*, of output y1", "e2*, of output y2"), primary.run(u, y).T, strict=True):
    top.plot(steps, r, ".-", ms=4, lw=1, label=name)
top.set(ylabel="residual [–]", title="Primary residuals: the equations as they stand", ylim=(-2.4, 2.9))
styles = ({"ls": "-", "lw": 4, "alpha": 0.35}, {"ls": "-", "marker": ".", "lw": 1}) * 2
settled = {}
for (name, design), style, colour in zip(designs.items(), styles, ("C0", "C0", "C3", "C3"), strict=True):
    gain = A.equivalent_to(design).rows[0].gain  # their scales differ, too
    r = design.run(u, y)[:, 0] / gain
    settled[name[0]] = r[-1]
    assert np.abs(r[steps < 30]).max() < 1e-12  # p1 and the input are not in it
    bottom.plot(steps, r, color=colour, label=name, **style)
bottom.set(
    ylabel="residual [–]", xlabel="time [s]", title="Four designs that ignore p1, in one scale", ylim=(-3.4, 0.7)
)
for ax, height in ((top, 2.35), (bottom, 0.25)):
    for start, end, fault in ((5, 20, "p1 = 1"), (30, 50, "p2 = 1")):
        ax.axvspan(start, end, color="0.5", alpha=0.12, lw=0)
        ax.text((start + end) / 2, height, fault, ha="center", color="0.3")
top.legend(loc="lower left", fontsize=8)
bottom.legend(loc="lower left", fontsize=8)
plt.show()
print("settled:", {name: float(value.round(6)) for name, value in settled.items()})

# %%
# Example 3: a direction for each fault
# -------------------------------------
# Now both faults shall be told apart by where the residual points: (2, 1) for p1 and (1, 2) for p2.
#
# A. A detection filter
# ~~~~~~~~~~~~~~~~~~~~~
# Both columns become eigenvectors. The printed gain is exact, and so is the pole 0.6 that no gain can move, an invariant zero.
directional = rs.design.detection_filter(plant, poles={"p1": [0.25], "p2": [0.3]})
print("K =", *(directional.observer.K.round(9) + 0.0).tolist(), sep="\n  ")
print(
    "poles:",
    np.sort(directional.evidence.poles.real).round(9),
    " fixed:",
    directional.evidence.fixed_poles.real.round(9),
)

# %%
# B. From parity equations
# ~~~~~~~~~~~~~~~~~~~~~~~~
# The paper gives one transformation W of the two equations, after which the responses are (6, 3) (z - 0.6) p1 and
# (1.5, 3) (z - 0.6) p2, once z - 0.5 is divided out of everything; its .671 is 47/70.
W = PolynomialMatrix.from_entries([[[3.5, -2.35], [-1, 0.35]], [[1, -0.5], [1, -0.5]]])
paper = primitive_part(W @ io.Gf.beside(io.H, -io.G))
print("common root:", paper.roots.real.round(9))
for name, column in {"p1": 0, "p2": 1, "y1": 2, "y2": 3, "u": 4}.items():
    entries = [(paper.matrix.coefficients[::-1, i, column].round(6) + 0.0).tolist() for i in range(2)]
    print(f"{name}: r1 {entries[0]}, r2 {entries[1]}  (powers z^2, z, 1)")

# %%
# These are the right coefficients. The printed relations are their negatives, which does not go with the printed responses, have
# 4.14 for the 4.15 at u, and in r2 the wrong sign at y2 even so.
#
# The two directions leave much freedom (three could be asked for); the design takes the shortest relations and of those a
# well-conditioned one. W above and the detection filter are other members of the same family.
parity = rs.design.directional_parity(plant, directions={"p1": [2, 1], "p2": [1, 2]})
print(parity.relations)
for name, generator in {"parity": parity, "detection filter": directional}.items():
    told = {fault: (d / np.abs(d).min()).round(6).tolist() for fault, d in generator.directions.items()}
    print(f"{name}: directions {told}")
print(parity.equivalent_to(directional))

# %%
# The residual plane: in one run p1 comes and goes, in another p2 grows. The residual stays on the line of the fault, whatever
# its time course.
both = {"p1": np.column_stack([np.sin(steps / 6.0), 0 * steps]), "p2": np.column_stack([0 * steps, steps / 70.0])}
fig, axes = plt.subplots(1, 2, figsize=(8, 4.5), layout="constrained")
for ax, (title, generator) in zip(
    axes, {"Detection filter": directional, "Parity relations": parity}.items(), strict=True
):
    reach = 0.0
    for (fault, f), colour in zip(both.items(), ("C0", "C1"), strict=True):
        r = generator.run(u, plant.system(("control", "fault")).simulate(np.hstack([u, f])))
        ax.axline((0, 0), tuple(generator.directions[fault]), color=colour, lw=5, alpha=0.3)
        ax.plot(*r.T, "o", ms=3, snap=False, color=colour, label=f"while {fault} acts")
        off = np.linalg.norm(r - np.outer(r @ generator.directions[fault], generator.directions[fault]), axis=1).max()
        reach = max(reach, 1.1 * np.abs(r).max())
        print(f"{title}, {fault}: off its line by at most {off:.0e}")
    ax.set(title=title, xlabel="first residual [–]", ylabel="second residual [–]", aspect="equal")
    ax.set(xlim=(-reach, reach), ylim=(-reach, reach))
    ax.legend(loc="lower right", fontsize=8)
plt.show()
