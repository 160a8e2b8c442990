"""
A campaign for three tanks, with the noise of a recording
=========================================================

The three tanks of :doc:`plot_three_tank` are nonlinear, their residual is coloured, and no noise model describes it. Then a
campaign draws its noise from the recording: blocks of fault-free residuals, one after the other in random order, and
faults on top. So even a plant of which only data are known gets a promise that is checked: how often there is a false alarm,
how small a leak is seen, and how late.
"""

import os
import textwrap
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import scipy.io

import residua as rs
from residua.library import simulate_three_tank, three_tank
from residua.validate import Scenario, ramp, step

# %%
# Recording and monitors
# ----------------------
# The benchmark's recording states no licence and is not part of the package. Where it is absent, the same plant is simulated
# with the benchmark's nonlinear model; the first line says which of the two it was.
file = Path(os.environ.get("RESIDUA_SHARED_DATA", "../../../shared/data")) / "three_tank_dts200" / "train_5ch.mat"
if file.is_file():
    print("Data: the benchmark's recording, train_5ch.mat.")
    data = scipy.io.loadmat(file)["normal"]
    u, y = data[:, :2], data[:, 2:]
else:
    print("Data: SIMULATED with the benchmark's nonlinear model; the recording is not on this machine.")
    run = simulate_three_tank(16008, seed=100)
    u, y = run.u, run.y
half = len(y) // 2

# %%
# One monitor looks at single samples, one sums: Page's CUSUM of each residual, on both sides. Both are fitted to the first
# half of the recording.
kalman = rs.design.kalman_filter(three_tank(dt=1.0))
tests = {
    "single samples": rs.decide.NormThreshold(persistence=1, false_alarm_rate=0.001),
    "CUSUM": rs.decide.CUSUM(shift=0.5, form="page", mean_time_between_false_alarms=5_000),
}
monitors = {}
for name, test in tests.items():
    monitor = rs.Monitor(kalman, test=test, isolate=rs.decide.Directional(signature="steady", window=100))
    monitors[name] = monitor.fit(u[:half], y[:half])
    print(textwrap.fill(f"{name}: {monitor.norm_test.basis}", 110, subsequent_indent="    "))

# %%
# Nothing has failed
# ------------------
# The second half was kept from both. It says how often each really is in alarm; 1,000 runs of half an hour whose noise is
# drawn from it say the same, with an interval.
noise = {}
for name, monitor in monitors.items():
    kept = monitor.run(u[half:], y[half:])
    noise[name] = rs.validate.resampled(kept)
    print(f"{name}: {kept.alarm[kept.decided].mean():.2%} of the second half in alarm; runs with {noise[name]}:")
    quiet = rs.validate.campaign(monitor, runs=1000, samples=1800, seed=1, noise=noise[name])
    print(f"   {quiet.false_alarm_rate()} in alarm, {quiet.time_between_false_alarms()} s between false alarms")

# %%
# The one was asked for one sample in a thousand, the other for one alarm in 5,000 s. Mean and tail of the residual in the second
# half are not just those of the first, and a promise from half a recording is as good as that.
#
# How small a leak is seen
# ------------------------
# A leak that opens suddenly, one that grows by half a percent of its largest size a second, a pipe that clogs, a sensor that
# reads too much, and a pump that delivers too little. Sizes are those of the plant's own units.
sizes = [0.25, 0.5, 1.0, 2.0]
unit = {
    fault: 1 / float(np.linalg.norm(direction @ monitors["single samples"].norm_test.metric))
    for fault, direction in kalman.steady_directions.items()
}
scenarios = [
    Scenario(fault, shape, size=[float(f"{unit[fault] * size:.2g}") for size in sizes])
    for fault, shape in {
        "leak 1": step(at=200),
        "leak 3": ramp(slope=0.005, at=200),
        "clog 13": step(at=200),
        "h2 sensor": step(at=200),
        "Q1 actuator": ramp(slope=0.005, at=200),
    }.items()
]
made = {
    name: rs.validate.campaign(
        monitor, scenarios, runs=100, samples=900, seed=2, noise=noise[name], within=600, inputs=u[half : half + 900]
    )
    for name, monitor in monitors.items()
}
print(made["CUSUM"].table())

# %%
# The same as pictures, for both. By chance, half of the runs of the single samples have some alarm in ten minutes; what is not
# above its dotted line is not seen at all.
figure, axes = plt.subplots(1, 5, figsize=(10, 3), sharey=True, layout="constrained")
for ax, (number, scenario) in zip(axes, enumerate(scenarios), strict=True):
    for colour, (name, one) in zip(("tab:blue", "tab:orange"), made.items(), strict=True):
        cases = [k for k, case in enumerate(one.cases) if case.scenario == number]
        seen = [one.detected(k) for k in cases]
        errors = [[s.value - s.low for s in seen], [s.high - s.value for s in seen]]
        sized = [one.cases[k].size for k in cases]
        ax.errorbar(sized, [s.value for s in seen], yerr=errors, fmt="o-", color=colour, capsize=3, label=name)
        ax.axhline(one.by_chance(cases[0]).value, color=colour, linestyle=":")
    ax.set(title=f"{scenario.fault}, {scenario.shape.name}", xlabel="size", ylim=(0, 1.05))
    ax.title.set_size("medium")
axes[0].set_ylabel("detected within 600 s")
figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
plt.show()

# %%
# With far fewer false alarms, though each lasts longer, the sums see faults of about half the size that single samples need,
# and minutes earlier. Run by run, with the same noise:
print(made["CUSUM"].compare(made["single samples"]).table())
