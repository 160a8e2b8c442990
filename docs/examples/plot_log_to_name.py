"""
From a log file to the name of a failed sensor
==============================================

No model, no labelled fault: an hour of a control valve in a sugar factory, one row a second, is all that there is. Half of
it goes into a model and a threshold; in the other half a sensor fails, and the monitor has to say since when and which.
That takes ten lines.

The hour is a real recording of the actuator benchmark DAMADICS, and the fault is added to it here: an offset of one
column. The recording is not part of the package; where it is absent, a valve is simulated, and the first line of output
says which of the two it was.
"""

import os
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import scipy.io

import residua as rs
from residua.report.plots import plot_diagnosis

# %%
# The log
# -------
# The controller's command, the pressures before and behind the valve, the position of its rod, and the flow.
INPUTS, OUTPUTS = ["command", "inlet pressure", "outlet pressure"], ["position", "flow"]
file = Path(os.environ.get("RESIDUA_SHARED_DATA", "../../../shared/data")) / "damadics/OneHourTestData_ExampleII.mat"


def simulated():
    """Return an hour of a valve that follows its command late, with noise."""
    rng = np.random.default_rng(0)
    slow = np.cumsum(rng.standard_normal((3600, 3)), axis=0) * [0.5, 1.0, 1.0]
    u = [60, 3500, 2600] + 5 * np.sin(slow / 5)
    valve = rs.Plant([[0.7, 0], [0.1, 0.6]], [[0.3, 0, 0], [0, 0.02, -0.02]], np.eye(2), dt=1.0)
    y = valve.system("control").simulate(u - u.mean(axis=0)) + [62, 17]
    return np.hstack([u, y + rng.standard_normal(y.shape)])


if file.is_file():
    print("Data: an hour of the benchmark's valve, OneHourTestData_ExampleII.mat.")
    rows = scipy.io.loadmat(file)["OneHourTestData_ExampleII"].T[:, [5, 1, 2, 6, 4]]
else:
    print("Data: SIMULATED; the recording is not on this machine.")
    rows = simulated()

log = pd.DataFrame(rows, columns=INPUTS + OUTPUTS)
first, second = log[:1800], log[1800:].reset_index(drop=True)


def failed(name, size):
    """Return the second half with an offset of a sensor from its 900th second on."""
    faulty = second.copy()
    faulty.loc[900:, name] += size
    return faulty


# %%
# A model, a monitor, a name
# --------------------------
# Everything is left to the defaults but the test, which looks at sums over ten rows, five in a row. In its second half hour the
# valve works at another point than in its first: the default test, which adds up a minute, sees offsets half as large and is in
# alarm 7 % of the time without any.
model = rs.identify.subspace(first, inputs=INPUTS, outputs=OUTPUTS, dt=1.0)
generator = rs.design.kalman_filter(model.plant.with_sensor_faults())
monitor = rs.Monitor(generator, test=rs.decide.NormThreshold(window=10, persistence=5)).fit(first)
diagnosis = monitor.run(failed("position", 3.0))  # percent of the stroke
print(diagnosis)

# %%
# What the model is worth
# -----------------------
# The report of the fit, on rows that the model has not seen. It is not a good model: it says a half of what the position
# does. That is enough for an offset that lasts.
print(model.report)

# %%
# The second half
# ---------------
figure = plt.figure(figsize=(8, 8), layout="constrained")
plot_diagnosis(diagnosis, figure=figure)

# %%
# The same with each sensor and several sizes. What is too small to be seen, or too small for the right name, shows too.
print("offset      in alarm before  in alarm after  began at  named")
for name in OUTPUTS:
    for size in (0.0, 0.5, 1.0, 2.0, 4.0):
        seen = monitor.run(failed(name, size))
        alarm = seen.main_alarm
        said = "-" if alarm is None else f"{alarm.onset:8.0f}  {alarm.candidates[0].name}"
        print(f"{size:3.1f} {name:<9}{seen.alarm[:900].mean():>13.1%} {seen.alarm[900:].mean():>15.1%}  {said}")
assert diagnosis.main_alarm.candidates[0].name == "position sensor"
