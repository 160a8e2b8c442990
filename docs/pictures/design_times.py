"""Draw how long designs take by the number of states, from the table of the page on speed."""

import csv
from pathlib import Path

import matplotlib.pyplot as plt

DATA = Path("..", "data", "design_times.csv")  # Sphinx runs a picture in its folder

with DATA.open(encoding="utf-8", newline="") as file:
    header, *rows = csv.reader(file)
states = [int(name.split()[0]) for name in header[1:-1]]
figure, axes = plt.subplots(figsize=(8.5, 4.2), layout="constrained")
for name, *times, slope in rows:
    axes.loglog(states, [float(t) for t in times], marker="o", label=f"{name}, slope {slope}" if slope else name)
axes.set_xticks(states, [str(n) for n in states])
axes.minorticks_off()
axes.set_xlabel("states")
axes.set_ylabel("processor time in s")
axes.grid(alpha=0.3)
axes.legend(fontsize="small", loc="upper left", bbox_to_anchor=(1.01, 1.0))
plt.show()
