"""Page of a live run: its frame; its script requests everything else from the server."""

from __future__ import annotations

from functools import lru_cache

from residua.report.page import Kit, document, footer
from residua.report.text import escape, safe_json

LIVE = Kit(
    scripts=("guard.js", "uplot.min.js", "axes.js", "reading.js", "live_charts.js", "live.js"),
    styles=("uplot.min.css", "page.css", "live.css"),
    connect="'self'",
    icon=True,
)

_BODY = """
<header class="live">
  <h1>{title}</h1>
  <p class="status" role="status"><span class="dot" aria-hidden="true"></span> <span id="status">Connecting</span></p>
</header>
<div id="problems" class="verdict fault" hidden><p class="headline"><span class="mark" aria-hidden="true">⚠</span>
  This run has a problem</p><ul></ul></div>
<ul id="away" hidden></ul>

<section id="overview" hidden>
  <div id="summary" class="verdict"><p class="headline"><span class="mark" aria-hidden="true"></span>
    <span class="words"></span></p><ul></ul></div>
  <div class="tools">
    <h3>Plants</h3>
    <input id="find" type="search" placeholder="Find a plant" aria-label="Find a plant" autocomplete="off"
      spellcheck="false">
    <span class="pager"><button id="back" type="button" aria-label="Plants before these">‹</button>
      <span id="range" class="muted"></span>
      <button id="on" type="button" aria-label="Plants after these">›</button></span>
  </div>
  <table class="plants">
    <thead><tr><th>Plant</th><th>State</th><th>Since</th><th>How sure</th><th class="num">Statistic / threshold</th>
      <th>Last sample</th></tr></thead>
    <tbody></tbody>
  </table>
</section>

<section id="plant" hidden>
  <p id="all"><a href="#">‹ All plants</a></p>
  <h2></h2>
  <div id="verdict" class="verdict"><p class="headline"><span class="mark" aria-hidden="true"></span>
    <span class="words"></span> <span class="tag"></span></p><ul></ul></div>
  <p id="facts" class="muted"></p>
  <div id="charts">
    <ul class="legend key">
      <li><span class="swatch band"></span>normal range of one residual</li>
      <li><span class="swatch alarm"></span>alarm</li>
      <li><span class="swatch onset"></span>first over its threshold</li>
      <li><span class="swatch missing"></span>data missing</li>
    </ul>
    <p class="muted screen"><span class="hover">Drag over a chart to zoom; double-click to show all. The cursors of all
      charts move together; the arrow keys move them, too.</span>
      <span class="tap">Tap a chart to read its values.</span>
      <button id="whole" type="button">Show all</button>
      <span id="held" hidden>Zoomed: the charts are paused.</span></p>
    <div id="statistic"></div>
    <h3>Residuals</h3>
    <div id="residuals"></div>
    <details id="more" hidden><summary></summary><div></div></details>
    <h3>Measured</h3>
    <div id="signals"></div>
  </div>
  <h3>Alarms</h3>
  <div id="alarms"></div>
</section>

<section id="happened" hidden>
  <h3>Events</h3>
  <p class="muted" id="none">No events yet.</p>
  <ol class="events"></ol>
</section>

<section id="connections" hidden>
  <h3>Sources and sinks</h3>
  <table class="ends"><tbody></tbody></table>
</section>
"""


@lru_cache(maxsize=4)
def live_page(title: str) -> str:
    """Return the page of a live run as text.

    It is complete but for the data, which its script asks of the server that the page comes from and of nobody else:
    the page's security policy allows no more. What is shown is shown as text, whatever it is.

    Parameters
    ----------
    title : str
        Names of the plants.

    Returns
    -------
    str
    """
    body = _BODY.format(title=escape(title))
    ending = footer("This page contacts only the server that it comes from.")
    return document(title, body + ending, safe_json({"title": title}), LIVE)


def live_policy() -> str:
    """Return the security policy of the page, for the header of its answer."""
    return f"{LIVE.policy}; frame-ancestors 'none'"
