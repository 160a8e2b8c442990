"""Report pages: one self-contained HTML file that needs no network."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

from residua.files import write_text
from residua.report.body import diagnosis_html, filter_html, summary_html, verdict_html
from residua.report.charts import chart_data
from residua.report.tables import Table, text_table
from residua.report.text import escape, safe_json
from residua.report.verdict import verdict
from residua.words import listing

if TYPE_CHECKING:
    from residua.design.core.generator import ResidualGenerator
    from residua.monitor.diagnosis import Diagnosis

__all__ = ["Section", "Table", "render", "write_demo_page", "write_page"]


@dataclass(frozen=True, eq=False)
class Section:
    """A part of a page: text, a table, a diagnosis and commands, each of them optional.

    All text is shown as it is; none of it is taken as HTML.

    Attributes
    ----------
    heading : str
    diagnosis : Diagnosis or None
    paragraphs : sequence of str, or str
    table : Table or None
    actual : sequence of str, or str, or None
        The faults that were really there (an empty sequence: none); the summary then says whether the
        diagnosis is right. ``None`` if that is not known.
    commands : sequence of str, or str
        Command lines, below the text, each on a line of its own with a button that copies it.
    folded : bool
        Whether only the heading and the verdict are shown until the reader opens the section.
    """

    heading: str
    diagnosis: Diagnosis | None = None
    paragraphs: Sequence[str] | str = ()
    table: Table | None = None
    actual: Sequence[str] | str | None = None
    commands: Sequence[str] | str = ()
    folded: bool = False


def write_page(diagnosis: Diagnosis, path: str | Path, *, title: str | None = None) -> Path:
    """Write the report page of one diagnosis.

    Parameters
    ----------
    diagnosis : Diagnosis
    path : str or Path
        The HTML file to write, in a folder that exists.
    title : str, optional
        ``"<plant>: fault diagnosis"`` when omitted.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    FileFormatError
        If the folder does not exist, the path is a folder, or writing there is not allowed.
    """
    if title is None:
        title = f"{diagnosis.generator.plant.name}: fault diagnosis"
    return write_text(path, render([Section("", diagnosis)], title))


def write_demo_page(
    sections: Sequence[Section], path: str | Path, title: str, *, introduction: Sequence[str] | str = ()
) -> Path:
    """Write one page with several diagnoses: a verdict and a summary on top, and each filter described once.

    The verdict on top is that of the first diagnosis that is not folded.

    Parameters
    ----------
    sections : sequence of Section
    path : str or Path
        The HTML file to write, in a folder that exists.
    title : str
    introduction : sequence of str, or str
        Paragraphs below the title.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    FileFormatError
        If the folder does not exist, the path is a folder, or writing there is not allowed.
    """
    return write_text(path, render(sections, title, introduction))


def render(sections: Sequence[Section], title: str, introduction: Sequence[str] | str = ()) -> str:
    """Return the page as text.

    Long recordings are drawn as the smallest and largest value of each bin of samples, so that no extreme
    is lost; the page says so. The page's security policy allows no network access and no script but its own.
    """
    shown = [(k, s) for k, s in enumerate(sections, 1) if s.diagnosis is not None]
    filters = _filters(sections)
    body = [f"<header><h1>{escape(title)}</h1>"]
    if len(shown) > 1:
        body.append(_first_verdict(shown))
    body.append(f"{paragraphs(introduction)}</header>")
    if len(shown) > 1:
        body.append(
            summary_html(
                [
                    (k, s.heading, s.diagnosis, None if s.actual is None else _names(s.actual))
                    for k, s in shown
                    if s.diagnosis is not None
                ]
            )
        )
    data = []
    for k, section in enumerate(sections, 1):
        parts = [paragraphs(section.paragraphs), commands(section.commands)]
        if section.table is not None:
            parts.append(text_table(section.table))
        if section.diagnosis is not None:
            charts = chart_data(section.diagnosis)
            link = _filter_number(filters, section.diagnosis) if len(filters) > 1 else 0
            parts.append(diagnosis_html(section.diagnosis, charts, number=len(data), filter_number=link))
            data.append(charts)
        body.append(f'<section id="s{k}">{_around(section, "".join(parts))}</section>')
    for k, (generator, users) in enumerate(filters, 1):
        used = listing(h for h in users if h) if len(filters) > 1 else ""
        body.append(filter_html(generator, number=k, several=len(filters) > 1, used_by=used))
    body.append(footer())
    return document(title, "\n".join(body), safe_json({"diagnoses": data}))


def _first_verdict(shown: Sequence[tuple[int, Section]]) -> str:
    """Return the verdict of the first unfolded diagnosis, with a link to its section."""
    k, section = next(((k, s) for k, s in shown if not s.folded), shown[0])
    assert section.diagnosis is not None
    link = f'<p class="muted">Case: <a href="#s{k}">{escape(section.heading or f"Diagnosis {k}")}</a></p>'
    return verdict_html(verdict(section.diagnosis), link)


def _around(section: Section, content: str) -> str:
    """Return the content of a section with its heading; folded below heading and verdict if requested."""
    heading = f"<h2>{escape(section.heading)}</h2>" if section.heading else ""
    if not section.folded:
        return heading + content
    outcome = "" if section.diagnosis is None else f" <span>{escape(verdict(section.diagnosis).headline)}</span>"
    return f'<details class="case"><summary>{heading}{outcome}</summary>{content}</details>'


def _filters(sections: Sequence[Section]) -> list[tuple[ResidualGenerator, list[str]]]:
    """Return each distinct generator once, with the headings of its sections."""
    filters: list[tuple[ResidualGenerator, list[str]]] = []
    for section in sections:
        if section.diagnosis is None:
            continue
        generator = section.diagnosis.generator
        for known, headings in filters:
            if known is generator:
                headings.append(section.heading)
                break
        else:
            filters.append((generator, [section.heading]))
    return filters


def _filter_number(filters: list[tuple[ResidualGenerator, list[str]]], diagnosis: Diagnosis) -> int:
    return next(k for k, (generator, _) in enumerate(filters, 1) if generator is diagnosis.generator)


def _names(names: Sequence[str] | str) -> tuple[str, ...]:
    return (names,) if isinstance(names, str) else tuple(names)


def paragraphs(text: Sequence[str] | str) -> str:
    """Return text as paragraphs, escaped."""
    return "".join(f"<p>{escape(paragraph)}</p>" for paragraph in _names(text))


def commands(lines: Sequence[str] | str) -> str:
    """Return command lines, each whole on its own line, escaped."""
    return "".join(f'<pre class="command"><code>{escape(line)}</code></pre>' for line in _names(lines))


def _version() -> str:
    from importlib import metadata  # slow to import, and needed only here

    try:
        return metadata.version("residua")
    except metadata.PackageNotFoundError:
        return "of unknown version"


def footer(complete: str = "This file is self-contained and loads nothing from the network.") -> str:
    """Return the footer of every page."""
    return (
        f'<footer class="muted">Made by residua {escape(_version())}. Charts: uPlot by Leon Sorokin, MIT licence '
        f"(text in the source of this page). {complete}</footer>"
    )


@cache
def _static(name: str) -> str:
    return resources.files("residua.report").joinpath("static", name).read_text(encoding="utf-8")


@dataclass(frozen=True)
class Kit:
    """Scripts and styles of a kind of page, by their names in the folder ``static``, and the hosts it may contact.

    Attributes
    ----------
    scripts, styles : tuple of str
    connect : str
        Where its scripts may ask for data, as a security policy says it; empty: nowhere.
    icon : bool
        Whether it says that it has no icon, so that a browser does not ask its server for one.
    """

    scripts: tuple[str, ...] = ("guard.js", "uplot.min.js", "axes.js", "reading.js", "page.js")
    styles: tuple[str, ...] = ("uplot.min.css", "page.css")
    connect: str = ""
    icon: bool = False

    @property
    def policy(self) -> str:
        """Security policy: hashes let exactly these scripts run, even if a name escaped its quotes."""
        allowed = " ".join(_hash(_static(script)) for script in self.scripts)
        connect = f"connect-src {self.connect}; " if self.connect else ""
        return (
            f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; img-src data:; {connect}"
            "base-uri 'none'; form-action 'none'"
        )


REPORT = Kit()


def document(title: str, body: str, data: str, kit: Kit = REPORT) -> str:
    """Return a whole page: its text, and the data for its script, as JSON."""
    guard, library, *own = (f"<script>{_static(script)}</script>" for script in kit.scripts)
    licence = _static("uplot-LICENSE.txt").replace("--", "- -")
    styles = "\n".join(_static(style) for style in kit.styles)
    icon = '<link rel="icon" href="data:,">\n' if kit.icon else ""
    scripts = "\n".join(own)
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{kit.policy}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="generator" content="residua">
<meta name="color-scheme" content="light dark">
{icon}<title>{escape(title)}</title>
<style>{styles}</style>
{guard}
</head>
<body>
<main>
{body}
</main>
<noscript><p>The charts need JavaScript, which is switched off here.</p></noscript>
<script type="application/json" id="residua-data">{data}</script>
<!-- uPlot 1.6.32
{licence}-->
{library}
{scripts}
</body>
</html>
"""


def _hash(script: str) -> str:
    digest = hashlib.sha256(script.encode()).digest()
    return f"'sha256-{base64.b64encode(digest).decode()}'"
