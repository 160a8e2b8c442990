"""The state of a genetic search as a file: what it has bred, and whose search it is."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.errors import FileFormatError, SettingError
from residua.files import read_bytes, write_text
from residua.json_files import check_checksum, dumps, loads
from residua.number_kinds import FINITE, INDEX, NumberKind, number_in
from residua.robust.estimators.search_box import BoxedCost, Matrix
from residua.visible import shortened

_FORMAT = "residua-genetic-search"
_VERSION = 2
#: Before it there was no checksum.
_OLDER = (1,)
#: Of a point that cannot be used it is infinite.
_COST = NumberKind("a number, or inf", "f", lambda x: x > -np.inf)
#: Settings that may differ: they say when a search ends, not how it goes.
_ENDS = ("generations", "patience", "polish")
#: How far the cost of a point may differ, relatively, from what it was: libraries round differently.
_RESUMED = 1e-6


@dataclass(frozen=True, eq=False)
class Progressed:
    """How far a genetic search is: its generation, ranked, and the smallest costs so far."""

    points: Matrix
    costs: NDArray[np.float64]
    history: list[float]
    evaluations: int


def save_checkpoint(path: str | Path, now: Progressed, whose: dict[str, Any]) -> None:
    """Write the state of a search with a fingerprint; the file appears whole or not at all."""
    content = {
        "format": _FORMAT,
        "version": _VERSION,
        "search": whose,
        "points": [[float(x).hex() for x in row] for row in now.points],
        "costs": [float(x).hex() for x in now.costs],
        "history": [float(x).hex() for x in now.history],
        "evaluations": now.evaluations,
    }
    write_text(Path(path), dumps(content))


def load_checkpoint(path: str | Path, own: dict[str, Any], box: BoxedCost) -> Progressed | None:
    """Read the state of the search with a fingerprint; None if there is no file."""
    path = Path(path)
    if not path.exists():
        return None
    try:
        content = loads(read_bytes(path, "checkpoint"), path.name)
        if content.get("format") != _FORMAT or content.get("version") not in (*_OLDER, _VERSION):
            raise ValueError(f'no "format": {_FORMAT!r} of version {_VERSION} in it')
        progress = Progressed(
            np.array([_numbers(row, "points", FINITE) for row in content["points"]]),
            np.array(_numbers(content["costs"], "costs", _COST)),
            _numbers(content["history"], "history", _COST),
            number_in(content["evaluations"], "evaluations", INDEX),
        )
        whose = dict(content["search"])
        if content["version"] == _VERSION and not check_checksum(content, path.name):
            raise ValueError("it was edited")
    except (ValueError, LookupError, TypeError, AttributeError, ArithmeticError, FileFormatError) as error:
        reason = shortened(str(error))
        raise FileFormatError(
            f"{path.name} is no checkpoint of a genetic search ({reason}): delete it to begin anew"
        ) from error
    for name, value in own.items():
        if whose.get(name) != value:
            raise SettingError(
                f"{path.name} belongs to another search: its {name} is not the same; delete it to begin anew, or give "
                "another checkpoint"
            )
    if (
        progress.points.shape != (len(progress.costs), box.dimension)
        or not len(progress.points)
        or not progress.history
        or np.any(progress.points < box.lower)
        or np.any(progress.points > box.upper)
        or np.any(np.diff(progress.costs) < 0)
        or progress.history[-1] != progress.costs[0]
        or any(later > earlier for earlier, later in pairwise(progress.history))
    ):
        raise FileFormatError(f"{path.name} is damaged: delete it to begin anew")
    # the probes may all be penalised, and then tell nothing of the cost of what is feasible
    if not np.allclose(box.values(box.inside(progress.points)), progress.costs, rtol=_RESUMED, atol=0.0):
        raise SettingError(
            f"{path.name} belongs to another search: its points have another cost now; delete it to begin anew, or "
            "give another checkpoint"
        )
    box.evaluations = progress.evaluations
    return progress


def _numbers(values: Any, where: str, kind: NumberKind) -> list[float]:
    """Return numbers that were written to the last bit, each of a kind."""
    return kind.check(np.array([float.fromhex(value) for value in values], dtype=float), where).tolist()


def settings_of(search: Any) -> dict[str, Any]:
    """Return the settings that make the way of a search; those that say when it ends may differ."""
    return {name: value for name, value in asdict(search).items() if name not in _ENDS}


def fingerprint(search: Any, box: BoxedCost, starts: Matrix) -> dict[str, Any]:
    """Return what makes a search the same: settings, box, starts, and the cost of three points."""
    probes = box.lower + np.array([0.25, 0.5, 0.8])[:, None] * box.width
    return {
        **settings_of(search),
        "lower": [float(x).hex() for x in box.lower],
        "upper": [float(x).hex() for x in box.upper],
        "start": [[float(x).hex() for x in row] for row in starts],
        "cost": [float(x).hex() for x in box.values(probes)],
    }
