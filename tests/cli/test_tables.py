"""Tables on a terminal: no name is cut or broken, whatever the width."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from residua.cli import screen

HEADER = ["alarm", "most likely", "cannot be told from"]
ROW = [1, "level 1 sensor-of-the-plant", "pump actuator"]


@pytest.mark.parametrize("width", range(34, 110, 4))
def test_words_stay_whole(width: int, monkeypatch: pytest.MonkeyPatch) -> None:
    shown = io.StringIO()
    terminal = Console(file=shown, width=width, force_terminal=True, color_system=None, markup=False)
    monkeypatch.setattr(screen, "console", lambda: terminal)
    screen.show_table(HEADER, [ROW])
    lines = shown.getvalue().splitlines()
    words = {word for text in (*HEADER, *map(str, ROW)) for word in text.split()}
    assert words <= {word.rstrip(":") for line in lines for word in line.split()}
    assert max(map(len, lines)) <= width
    assert any("─" in line for line in lines) == (width >= 40)
