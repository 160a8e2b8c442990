"""Numbers and names as text that is safe inside a page."""

from __future__ import annotations

import html
import json
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
    """Return any value as text with control characters and escapes shown, not sent."""
    return str(value).translate(_ACTING)


def escape(value: object) -> str:
    """Return any value as text with every character that means something in HTML, or to a terminal, replaced."""
    return html.escape(visible(value), quote=True)


def with_unit(name: str, unit: str) -> str:
    """Return a name followed by its unit in brackets, if it has one."""
    return f"{name} [{unit}]" if unit else name


def rounded(values: NDArray[np.float64], relative: bool = False) -> list[float | None]:
    """Return values with the digits that a chart can show, and ``None`` for those that are not finite.

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
    """Return JSON for use inside a script element: without ``<``, ``>`` or ``&``."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False, ensure_ascii=False)
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return text
