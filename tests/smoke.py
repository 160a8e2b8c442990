"""An installed residua at work, from outside its source: ``python -I smoke.py [compiled]``.

It needs NumPy and SciPy alone, designs, calibrates, runs, steps and saves, and prints as its last line whether the
compiled kernel ran and a hash of the residuals, which is the same with and without the kernel. With ``compiled`` it
fails where the kernel is not there, as of a wheel whose compiler failed.
"""

import hashlib
import sys
import tempfile
from pathlib import Path

import numpy as np

import residua as rs
from residua.library import simulate_three_tank, three_tank
from residua.linear.systems.recursion import compiled


def check(condition: bool, words: str) -> None:
    """Stop where something is not as it should be, with Python's ``-O`` as well."""
    if not condition:
        sys.exit(f"smoke test: {words}")


def main() -> None:
    """From a plant to the name of the fault."""
    source = Path(__file__).resolve().parent.parent / "src"
    check(source not in Path(rs.__file__).resolve().parents, f"{rs.__file__} is the source, not an installation")
    plant = three_tank().with_noise(process=1e-4, measurement=0.02)
    monitor = rs.Monitor(rs.design.kalman_filter(plant), test=rs.decide.NormThreshold(persistence=5, window=10))
    normal = simulate_three_tank(20_000)
    monitor.fit(normal.u, normal.y, false_alarm_rate=0.01)
    hole = 0.05 * (np.arange(1500) >= 600)
    faulty = simulate_three_tank(1500, faults={"leak 3": hole}, seed=1)
    diagnosis = monitor.run(faulty.u, faulty.y)
    named = [line for line in str(diagnosis).splitlines() if line.strip().startswith("1. leak 3 ")]
    check(len(diagnosis.alarms) == len(named) == 1, f"the leak was not named once:\n{diagnosis}")

    with tempfile.TemporaryDirectory() as folder:
        monitor.save(Path(folder) / "tank.json")
        again = rs.Monitor.load(Path(folder) / "tank.json").run(faulty.u, faulty.y)
        page = diagnosis.to_html(Path(folder) / "report.html")  # with the files that the package brings
        check(page.stat().st_size > 10_000, "the report page is empty")
    check(np.array_equal(again.residuals, diagnosis.residuals), "the saved monitor gives other residuals")
    digest = hashlib.sha256(np.ascontiguousarray(diagnosis.residuals).tobytes()).hexdigest()[:16]
    kernel = "compiled" if compiled() else "numpy"
    check(sys.argv[1:] in ([], [kernel]), f"expected {sys.argv[1:]}, not {kernel}")
    print(f"residua {rs.__version__}", kernel, digest)


if __name__ == "__main__":
    main()
