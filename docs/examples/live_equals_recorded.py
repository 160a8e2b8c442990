"""
A live run equals a recorded one
================================

A filter that is fed one sample at a time gives the same numbers, to the last bit, as one run over the whole
recording. So a threshold that was set on recordings means the same in operation.
"""

import matplotlib.pyplot as plt
import numpy as np

from residua.linear.recursion import run_filter

# %%
# A residual for a sensor: an observer of a first-order lag, ``x[k+1] = 0.9 x[k] + 0.1 u[k]``, whose output
# is compared with the measurement. Its inputs are the control ``u``, then the measurement ``y``.
gain = 0.3
A, B = [[0.9 - gain]], [[0.1, gain]]
C, D = [[-1.0]], [[0.0, 1.0]]

# %%
# The sensor reads 0.2 too high from sample 120 on.
rng = np.random.default_rng(1)
time = np.arange(200)
u = np.sign(np.sin(time / 15.0))
x = np.zeros(201)
for k in time:
    x[k + 1] = 0.9 * x[k] + 0.1 * u[k]
y = x[:-1] + 0.01 * rng.normal(size=200) + 0.2 * (time >= 120)
data = np.column_stack([u, y])[np.newaxis]  # (plants, time, channels)

_, recorded = run_filter(A, B, C, D, np.zeros((1, 1)), data)

# %%
# The same, one sample at a time: the state is handed on.
state, live = np.zeros((1, 1)), []
for k in time:
    state, r = run_filter(A, B, C, D, state, data[:, k : k + 1])
    live.append(r[0, 0, 0])
print("same bits:", np.array_equal(recorded[0, :, 0], live))

# %%
figure, axes = plt.subplots(2, sharex=True, layout="constrained")
axes[0].plot(time, y, label="measurement")
axes[0].plot(time, u, label="control", linewidth=0.8)
axes[0].legend()
axes[1].plot(time, recorded[0, :, 0], label="residual")
axes[1].axvline(120, color="0.6", linestyle=":", label="fault")
axes[1].set_xlabel("sample")
axes[1].legend()
plt.show()
