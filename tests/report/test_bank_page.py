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
from report_examples import changed as with_changes
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
    assert found.confidence == "good match"
    assert found.headline.startswith(f"Fault found: {FAULT}, a good match by its code, alarm raised at ")
    assert one.alarms[0].to_dict()["word"] == "good match"
    assert "a fault that is not listed could fire the same ones" in " ".join(found.sentences)
    text = words(render([Section("", one)], "t"))
    assert "Fired: without y1, without y3, without y4 and without y5; code of 'y2 sensor' (exact)." in text
    assert re.search(r"In [\d.]+ % of the alarm's samples these were the members that fired", text)
    assert "The score is the fraction of the members that agree with a code." in text
    assert "cosine" not in text, "nothing is said of directions"


def test_two_faults_are_not_a_found_fault() -> None:
    pair = diagnosis({"y1 sensor": 5.0, "y3 sensor": -4.0}, monitor(dedicated=True))
    found = verdict(pair)
    assert found.confidence == "either"
    assert found.headline.startswith("Fault found: either 2 at once, y1 sensor (fired from ")
    assert found.headline.endswith(", or one that is not listed.")
    assert pair.main_alarm is not None
    word = pair.main_alarm.word
    assert word is not None
    assert word.line == "either y1 sensor and y3 sensor at once or something not listed"
    assert found.present == (("y1 sensor",), ("y3 sensor",))
    sections = [Section("two", pair, actual=["y1 sensor", "y3 sensor"]), Section("one", pair, actual="y1 sensor")]
    text = words(render(sections, "t"))
    assert "y1 sensor and y3 sensor ✓ right" in text
    assert "y1 sensor and y3 sensor ✗ wrong" in text
    general = diagnosis({"y1 sensor": 5.0, "y3 sensor": -4.0})
    assert verdict(general).confidence == "poor match"
    sections = [Section("two", general, actual=["y1 sensor", "y3 sensor"]), Section("one", general, actual="y1 sensor")]
    text = words(render(sections, "t"))
    assert "several faults, or an unknown one ✓ right" in text
    assert "several faults, or an unknown one ✗ missed" in text


ALL, NONE = "something not listed", "no listed fault fires just these members"


@pytest.mark.parametrize(
    ("codes", "pattern", "answer", "line"),
    [
        ([[1, 1, 1, 0, 0], [0, 0, 1, 1, 1]], (1, 1, 1, 0, 0), "exact", "f1, a good match by its code"),
        ([[1, 1, 1, 0, 0], [0, 0, 1, 1, 1]], (1, 1, 0, 0, 0), "degraded", f"either f1 or {ALL}"),
        ([[1, 1, 1, 0, 0], [0, 0, 1, 1, 1]], (1, 1, 1, 1, 0), "nearest", f"a poor match: {NONE}; nearest is f1"),
        ([[1, 1, 1, 0, 0], [0, 0, 1, 1, 1]], (1, 0, 0, 1, 0), "unknown", f"a poor match: {NONE}"),
        ([[1, 1, 1, 0, 0], [0, 0, 1, 1, 1]], (0, 0, 1, 0, 0), "unknown", f"either f1, f2 or {ALL}"),
        ([[1, 1, 1, 0, 0], [1, 1, 1, 0, 0]], (1, 1, 1, 0, 0), "exact", "either f1 or f2"),
        ([[1, 1, 1, 0, 0], [1, 1, 0, 0, 0]], (1, 1, 1, 0, 0), "exact", "either f1 or f2"),
        ([[1, 1, 1, 0, 0], [1, 1, 1, 1, 1]], (1, 1, 1, 0, 0), "exact", "either f1 or f2"),
        ([[1, 1, 1, 1, 1], [1, 1, 0, 0, 0]], (1, 1, 1, 1, 1), "exact", f"either f1 or {ALL}"),
        ([[1, 1, 1, 0, 0], [1, 1, 1, 1, 0]], (0, 1, 1, 1, 0), "nearest", f"either f2 or {ALL}"),
    ],
)
def test_readings_have_one_of_four_words(
    one: rs.Diagnosis, codes: list, pattern: tuple, answer: str, line: str
) -> None:
    test = code_test(Structured(), np.array(codes, dtype=bool).T, ["f1", "f2"], one.members)
    (alarm,) = one.alarms[-1:]
    changed = replace(alarm, reading=test.read(pattern), start=800, stop=1500, read_share=0.9)
    assert changed.reading is not None
    assert changed.reading.answer == answer
    word = test.word(changed, 50)
    assert word.line == line
    found = verdict(with_changes(one, alarms=(changed,), codes=test, isolation=test))
    assert found.confidence == word.kind
    assert line in found.headline
    wavering = test.word(replace(changed, read_share=0.3), 50)
    assert wavering.line.startswith("too early to be sure of the name, for the members that fire change")
    short = test.word(replace(changed, stop=810), 50)
    assert short.line.startswith("too early to be sure of the name, for the alarm is shorter than the 50 samples")


def test_the_code_table_shows_what_fired(one: rs.Diagnosis) -> None:
    table = code_table(one)
    assert one.naming.codes is not None
    rows = re.findall(r"<tr>(.*?)</tr>", table, flags=re.DOTALL)[1:]
    assert len(rows) == 5 + 1
    marks = [re.findall(r'<td class="(on|off)( differs)?"', row) for row in rows]
    fired = [mark == "on" for mark, _ in marks[-1]]
    assert fired == [True, False, True, True, True]
    for code, row in zip(one.naming.codes.codes.T, marks, strict=False):
        assert [mark == "on" for mark, _ in row] == code.tolist()
        assert [bool(off) for _, off in row] == [a != b for a, b in zip(code, fired, strict=True)]
    assert re.findall(r"(\d) of 5", table) == ["3", "5", "3", "3", "3"]
    assert code_table(with_changes(one, codes=None)) == ""
    assert "differs" not in code_table(replace(one, alarms=()))


def test_the_charts_have_every_member(one: rs.Diagnosis) -> None:
    charts = chart_data(one)["charts"]
    members = [c for c in charts if c["kind"] == "member"]
    assert [c["label"] for c in members] == list(one.members)
    for m, chart in enumerate(members):
        assert chart["threshold"] == one.parts.thresholds[m]
        drawn = np.array([np.nan if v is None else v for v in chart["y"][0]], dtype=float)
        np.testing.assert_allclose(drawn, one.parts.statistics[:, m], rtol=1e-3)
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
    assert sized.naming.codes is not None
    nasty = replace(sized.naming.codes, members=tuple(m.name for m in members))
    alarms = tuple(replace(a, reading=nasty.read(a.reading.pattern)) for a in sized.alarms if a.reading)
    page = render([Section("", with_changes(sized, codes=nasty, alarms=alarms))], "t")
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
