"""Numbers and names as text that is safe inside a page."""

from __future__ import annotations

import html
import json
import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from residua.monitor import naming

if TYPE_CHECKING:
    from residua.decide.alarm import Size


#: Characters that a screen acts on instead of showing them: controls, escapes, and those that turn text around.
_ACTING = {
    **{code: f"\\x{code:02x}" for code in (*range(32), *range(127, 160))},
    **{
        code: f"\\u{code:04x}"
        for code in (0x061C, 0x200E, 0x200F, *range(0x2028, 0x202F), *range(0x2066, 0x206A), 0xFEFF)
    },
    **{code: f"\\u{code:04x}" for code in range(0xD800, 0xE000)},
}


def visible(value: object) -> str:
    """Return any value as text in which control characters and escapes are shown, not sent."""
    return str(value).translate(_ACTING)


def escape(value: object) -> str:
    """Return any value as text with every character that means something in HTML, or to a terminal, replaced."""
    return html.escape(visible(value), quote=True)


def number(value: float | None, digits: int = 4) -> str:
    """Return a number as short text; a dash when there is none."""
    if value is None or math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    return f"{value:.{digits}g}".replace("-", "−").replace("e+", "e")


def score(value: float) -> str:
    """Return a correlation with three decimals; a dash when it was not judged."""
    return f"{round(value, 3) + 0.0:.3f}" if math.isfinite(value) else "–"  # no -0


def seconds(value: float | None) -> str:
    """Return a time with its unit."""
    return "–" if value is None or not math.isfinite(value) else f"{number(value, 7)} s"


def size_text(size: Size) -> str:
    """Return an estimated size with its unit and its last value."""
    unit = f" {size.unit}" if size.unit else ""
    spread = "" if size.deviation is None else f" ± {number(size.deviation, 2)}"
    last = f" (last {number(size.last, 3)}{unit})" if math.isfinite(size.last) else ""
    return f"{number(size.mean, 3)}{spread}{unit}{last}"


def sizes_text(sizes: Sequence[Size]) -> str:
    """Return the estimated sizes of one candidate, each with its fault where there are several."""
    return naming.sizes_text(sizes, size_text)


def lead_text(lead: float) -> str:
    """Return a lead in twice the logarithm of the likelihood; below a tenth it means nothing."""
    return f"{lead:.1f}" if lead < 1000 else f"{lead:,.0f}"


def percent(part: int, whole: int) -> str:
    """Return a share in per cent that reads 0 or 100 only where it is exactly that."""
    share = 100 * part / whole if whole else 0.0
    if 0 < share < 0.01:
        return "< 0.01 %"
    if 99.99 < share < 100:
        return "> 99.99 %"
    return f"{math.floor(100 * share + 1e-6) / 100:g} %"


def with_unit(name: str, unit: str) -> str:
    """Return a name followed by its unit in brackets, where it has one."""
    return f"{name} [{unit}]" if unit else name


def some(names: Iterable[str], most: int = 10) -> str:
    """Return names as a phrase, the first ones and how many there are besides."""
    items = list(names)
    more = len(items) - most
    return listing(items if more < 2 else [*items[:most], f"{more} more"])


def listing(names: Iterable[str], last: str = "and") -> str:
    """Return names as a phrase: ``a, b and c``."""
    items = list(names)
    if len(items) < 2:
        return "".join(items)
    return f"{', '.join(items[:-1])} {last} {items[-1]}"


def rounded(values: NDArray[np.float64], relative: bool = False) -> list[float | None]:
    """Return values with the digits that a chart can show, and ``None`` where they are not finite.

    Five digits of the range that the values span (``relative=False``), so that a small ripple on a large
    offset survives; or four digits of each value, for a logarithmic axis.
    """
    finite = np.isfinite(values)
    if not finite.any():
        return [None] * len(values)
    digits = 4
    if not relative:
        seen = values[finite]
        span = float(np.ptp(seen))
        largest = float(np.abs(seen).max())
        if span > 0:
            digits = min(15, 5 + max(0, math.ceil(math.log10(largest / span))))
    form = f"%.{digits}g"
    return [float(form % v) if ok else None for v, ok in zip(values.tolist(), finite.tolist(), strict=True)]


def safe_json(value: Any) -> str:
    """Return JSON that can stand inside a script element: no ``<``, ``>`` or ``&`` remains in it."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False, ensure_ascii=False)
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return text
