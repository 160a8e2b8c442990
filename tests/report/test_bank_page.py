"""Pages and plots of a bank, and of faults that are estimated."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest

import residua as rs
from bank_examples import hand_made_bank, recording, sampled_plant, static_estimator
from page_reader import NASTY, read, words
from residua.decide import NormThreshold
from residua.decide.structured import Structured, code_test
from residua.report.charts import chart_data
from residua.report.codes import code_table, member_order
from residua.report.page import Section, render
from residua.report.plots import plot_diagnosis, plot_structure
from residua.report.verdict import verdict

FAULT = "y2 sensor"


def monitor(*, estimator: bool = False, dedicated: bool = False) -> rs.Monitor:
    plant = sampled_plant(5, outputs=5)
    beside = static_estimator(plant, FAULT) if estimator else None
    made = rs.Monitor(hand_made_bank(plant, dedicated=dedicated), estimator=beside, test=NormThreshold(window=10))
    return made.fit(*recording(plant, 3000, seed=99))


def diagnosis(faults: dict[str, float], watch: rs.Monitor | None = None) -> rs.Diagnosis:
    found = (watch or monitor()).run(*recording(sampled_plant(5, outputs=5), faults=faults))
    assert isinstance(found, rs.Diagnosis)
    return found


@pytest.fixture(scope="module")
def one() -> rs.Diagnosis:
    return diagnosis({FAULT: 4.0})


@pytest.fixture(scope="module")
def sized() -> rs.Diagnosis:
    return diagnosis({FAULT: 4.0}, monitor(estimator=True))


def test_the_verdict_says_what_fired_and_what_that_is(one: rs.Diagnosis) -> None:
    found = verdict(one)
    assert found.confidence == "exact code"
    assert found.headline.startswith(f"Fault found: {FAULT}, alarm raised at ")
    text = words(render([Section("", one)], "t"))
    assert "Fired: without y1, without y3, without y4 and without y5; code of 'y2 sensor' (exact)." in text
    assert re.search(r"In [\d.]+ % of the alarm's samples these were the members that fired", text)
    assert "The score is the fraction of the members that agree with a code." in text
    assert "cosine" not in text, "nothing is said of directions"


def test_two_faults_are_not_a_found_fault() -> None:
    pair = diagnosis({"y1 sensor": 5.0, "y3 sensor": -4.0}, monitor(dedicated=True))
    found = verdict(pair)
    assert found.confidence == "exact codes"
    assert found.headline.startswith("2 faults found: y1 sensor (fired from ")
    assert found.present == (("y1 sensor",), ("y3 sensor",))
    sections = [Section("two", pair, actual=["y1 sensor", "y3 sensor"]), Section("one", pair, actual="y1 sensor")]
    text = words(render(sections, "t"))
    assert "y1 sensor and y3 sensor ✓ right" in text
    assert "y1 sensor and y3 sensor ✗ wrong" in text
    general = diagnosis({"y1 sensor": 5.0, "y3 sensor": -4.0})
    assert verdict(general).confidence == "no code"
    sections = [Section("two", general, actual=["y1 sensor", "y3 sensor"]), Section("one", general, actual="y1 sensor")]
    text = words(render(sections, "t"))
    assert "more than one fault, or one not known ✓ right" in text
    assert "more than one fault, or one not known ✗ missed" in text


def test_the_answers_have_their_own_words(one: rs.Diagnosis) -> None:
    codes = np.array([[1, 1, 1, 0, 0], [0, 0, 1, 1, 1]], dtype=bool).T
    test = code_test(Structured(), codes, ["a", "b"], one.members)
    (alarm,) = one.alarms[-1:]
    for pattern, answer in (((1, 1, 0, 0, 0), "degraded"), ((1, 1, 1, 1, 0), "nearest")):
        changed = replace(alarm, reading=test.read(pattern), start=800, stop=1500, read_share=0.9)
        found = verdict(replace(one, alarms=(changed,), codes=test))
        assert found.confidence == f"{answer} code"
        assert f"Fault found: a ({answer} code)" in found.headline
        wavering = replace(changed, read_share=0.3)
        assert verdict(replace(one, alarms=(wavering,), codes=test)).confidence == "unsteady code"
        short = replace(changed, stop=810)
        assert verdict(replace(one, alarms=(short,), codes=test)).confidence == "too early"


def test_the_code_table_shows_what_fired(one: rs.Diagnosis) -> None:
    table = code_table(one)
    assert one.codes is not None
    rows = re.findall(r"<tr>(.*?)</tr>", table, flags=re.DOTALL)[1:]
    assert len(rows) == 5 + 1
    marks = [re.findall(r'<td class="(on|off)( differs)?"', row) for row in rows]
    fired = [mark == "on" for mark, _ in marks[-1]]
    assert fired == [True, False, True, True, True]
    for code, row in zip(one.codes.codes.T, marks, strict=False):
        assert [mark == "on" for mark, _ in row] == code.tolist()
        assert [bool(off) for _, off in row] == [a != b for a, b in zip(code, fired, strict=True)]
    assert re.findall(r"(\d) of 5", table) == ["3", "5", "3", "3", "3"]
    assert code_table(replace(one, codes=None)) == ""
    assert "differs" not in code_table(replace(one, alarms=()))


def test_the_charts_have_every_member(one: rs.Diagnosis) -> None:
    charts = chart_data(one)["charts"]
    members = [c for c in charts if c["kind"] == "member"]
    assert [c["label"] for c in members] == list(one.members)
    for m, chart in enumerate(members):
        assert chart["threshold"] == one.member_thresholds[m]
        drawn = np.array([np.nan if v is None else v for v in chart["y"][0]], dtype=float)
        np.testing.assert_allclose(drawn, one.member_statistics[:, m], rtol=1e-3)
    (ratio,) = [c for c in charts if c["kind"] == "statistic"]
    assert ratio["threshold"] == 1.0


def test_many_members_are_shown_by_how_far_they_went(one: rs.Diagnosis) -> None:
    assert member_order(one, 8) == [0, 1, 2, 3, 4]
    order = member_order(one, 3)
    assert order[-1] == 1, "the silent member comes last"
    assert sorted(order) == [0, 1, 2, 3, 4]


def test_estimates_are_drawn_with_their_units(sized: rs.Diagnosis) -> None:
    page = render([Section("", sized)], "t")
    text = words(page)
    assert "Estimated size of y2 sensor [m]" in text
    assert sized.candidates[0].size is not None
    assert f"Estimated size of y2 sensor: {sized.candidates[0].size:.3g} m (last " in text
    data = json.loads(read(page).data)["diagnoses"][0]["charts"]
    (chart,) = [c for c in data if c.get("estimate")]
    assert (chart["kind"], chart["unit"], chart["estimate"]) == ("residual", "m", FAULT)
    assert page.index("Largest ratio of a member") < page.index("Estimated size of y2 sensor [m]"), "the test is first"


def test_nothing_of_a_bank_is_taken_as_html(sized: rs.Diagnosis) -> None:
    generator = sized.generator
    members = tuple(replace(m, name=f"{NASTY} {k}") for k, m in enumerate(generator.members))
    assert sized.codes is not None
    nasty = replace(sized.codes, members=tuple(m.name for m in members))
    alarms = tuple(replace(a, reading=nasty.read(a.reading.pattern)) for a in sized.alarms if a.reading)
    page = render([Section("", replace(sized, codes=nasty, alarms=alarms))], "t")
    reader, plain = read(page), read(render([Section("", sized)], "t"))
    assert [tag for tag, _ in reader.tags].count("script") == [tag for tag, _ in plain.tags].count("script")
    assert "img" not in [tag for tag, _ in reader.tags]


def test_plots_show_members_and_estimates(one: rs.Diagnosis, sized: rs.Diagnosis) -> None:
    matplotlib = pytest.importorskip("matplotlib")
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    for found, more in ((one, 0), (sized, 1)):
        figure = plot_diagnosis(found, figure=Figure(figsize=(8, 12)))
        FigureCanvasAgg(figure).draw()
        text = " | ".join(t.get_text() for t in figure.findobj(matplotlib.text.Text))
        assert len(figure.axes) == 5 + 1 + 1 + more
        assert "without y3" in text
        for panel in figure.axes[: 5 + more]:  # no name reaches into the panel above or below
            extent = panel.yaxis.label.get_window_extent()
            assert panel.bbox.y0 - 12 < extent.y0
            assert extent.y1 < panel.bbox.y1 + 12
        assert "largest ratio to\nthreshold [–]" in text
        assert ("estimated y2 sensor" in text) == ("[m]" in text) == bool(more)
    ax = plot_structure(one.generator, ax=Figure().subplots())
    assert [t.get_text() for t in ax.get_xticklabels()] == list(one.members)
    assert ax.get_xlabel() == "member"
