from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from report_examples import diagnosis, generator
from residua.errors import MissingExtraError
from residua.report.plots import plot_diagnosis, plot_directions, plot_structure

matplotlib = pytest.importorskip("matplotlib")


@pytest.fixture(autouse=True)
def _no_figure_stays():
    yield
    if "matplotlib.pyplot" in sys.modules:
        sys.modules["matplotlib.pyplot"].close("all")


def drawn(figure) -> str:
    """Draw for real, and return every text of the figure."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    FigureCanvasAgg(figure).draw()
    return " | ".join(t.get_text() for t in figure.findobj(matplotlib.text.Text))


def test_figure_has_names_units_threshold_and_alarm():
    figure = plot_diagnosis(diagnosis())
    text = drawn(figure)
    named = ("r level 1 [m]", "time [s]", "statistic [–]", "threshold", "alarm", "first over", "level 2 sensor")
    for expected in named:
        assert expected in text
    assert len(figure.axes) == 5


def test_nothing_is_left_in_pyplot():
    code = (
        "import sys, report_examples as e; from residua.report.plots import *; d = e.diagnosis(50)\n"
        "plot_diagnosis(d); plot_structure(d.generator); plot_directions(d.generator)\n"
        "assert 'matplotlib.pyplot' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=__file__.rsplit("report", 1)[0])


def test_pyplot_knows_the_figures_of_a_caller_who_uses_it():
    code = (
        "import matplotlib; matplotlib.use('Agg')\n"
        "import matplotlib.pyplot as plt, report_examples as e; from residua.report.plots import *\n"
        "d = e.diagnosis(50)\n"
        "figures = [plot_diagnosis(d), plot_structure(d.generator).figure, plot_directions(d.generator).figure]\n"
        "assert [plt.figure(k) for k in plt.get_fignums()] == figures\n"
        "given = matplotlib.figure.Figure()\n"
        "assert plot_diagnosis(d, figure=given) is given and len(plt.get_fignums()) == 3"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=__file__.rsplit("report", 1)[0])


def test_given_axes_get_only_the_statistic():
    from matplotlib.figure import Figure

    ax = Figure().subplots()
    assert plot_diagnosis(diagnosis(), ax=ax) is ax
    assert ax.get_ylabel() == "statistic [–]"
    assert len(ax.figure.axes) == 1


def test_given_figure_is_used():
    from matplotlib.figure import Figure

    figure = Figure()
    assert plot_diagnosis(diagnosis(), figure=figure) is figure


def test_diagnosis_plot_delegates():
    assert len(diagnosis().plot().axes) == 5


@pytest.mark.parametrize(
    "changes",
    [
        {"groups": (), "scores": np.zeros((600, 0))},
        {"center": np.full(3, np.nan), "threshold": np.inf},
        {"residuals": np.full((600, 3), np.nan), "missing": np.ones(600, dtype=bool)},
    ],
)
def test_unusual_diagnoses_plot(changes):
    drawn(plot_diagnosis(diagnosis(**changes)))


def test_names_are_not_taken_for_mathematics():
    drawn(plot_diagnosis(diagnosis(gen=generator(2, names=["$a_{", "b$"]), source="$")))
    drawn(plot_structure(generator(2, names=["$a_{", "b$"])).figure)


@pytest.mark.parametrize("n", [1, 2, 3, 5])
def test_generator_plots(n):
    gen = generator(n, noise=n == 5)
    assert "pump actuator" in drawn(plot_structure(gen).figure)
    ax = plot_directions(gen)
    assert "pump actuator" in drawn(ax.figure)
    assert ("whitened" in ax.get_title()) == (n == 5)


@pytest.mark.parametrize("n", [2, 3])
def test_directions_are_grouped_and_faults_without_one_are_named(n):
    gen = generator(n)
    unseen = gen.faults[0]
    gen = replace(gen, subspaces={**gen.subspaces, unseen: np.zeros((n, 0))})
    gen.__dict__["steady_directions"] = {**gen.steady_directions, unseen: np.zeros(n)}
    ax = plot_directions(gen)
    assert unseen in drawn(ax.figure)
    if n == 2:
        assert f"{unseen} (no signature)" in drawn(ax.figure)
    else:
        assert [t.get_text() for t in ax.texts].count("–") == 2 * len(ax.get_xticks()) - 1
    same = replace(generator(n), subspaces=dict.fromkeys(gen.faults, np.eye(n)[:, :1]))
    assert " or ".join(gen.faults) in drawn(plot_directions(same).figure).replace("\n", " ")


def test_long_recordings_are_thinned():
    d = diagnosis(50_000)
    d = replace(d, residuals=np.where(np.arange(50_000)[:, None] == 777, 9.0, d.residuals))
    line = plot_diagnosis(d).axes[0].lines[-1]
    assert len(line.get_ydata()) <= 4000
    assert max(line.get_ydata()) == 9.0


def test_absent_matplotlib_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(MissingExtraError, match=r"residua\[plot\]"):
        plot_diagnosis(diagnosis(50))
