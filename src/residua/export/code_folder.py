"""A monitor as a folder of source files."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from residua.errors import DataError
from residua.export.c99 import code, header
from residua.export.identifiers import checked_identifier, identifier
from residua.export.monitor_program import MonitorProgram, monitor_program, precision_named
from residua.export.selftest import comparison, of_rounding, selftest
from residua.export.structured_text import function_block
from residua.files import replacing
from residua.monitor import Monitor


def to_c(
    monitor: Monitor,
    folder: str | os.PathLike[str],
    *,
    name: str | None = None,
    precision: str = "double",
    missing: str = "as monitored",
    overwrite: bool = False,
) -> Path:
    """Write a monitor as C99: ``NAME.h``, ``NAME.c``, a self-test and a Makefile.

    ``NAME_init(&state)`` and ``NAME_step(&state, u, y, &decision)`` do the same as :meth:`residua.Monitor.step`:
    filter, operating point, missing values, settling, test, persistence, and the direction that names a group of
    faults.

    Guaranteed: in double precision, compiled without contraction of products and sums (``-std=c99`` with gcc and clang,
    else ``-ffp-contract=off``), the bits of the monitor, at any optimisation that keeps to IEEE 754. In single
    precision residuals are off by no more than the bound in the header, while signals stay within the sizes there. No
    memory is allocated, nothing recurses, every loop is bounded, and nothing but ``sqrt`` and ``fabs`` is called.

    Parameters
    ----------
    monitor : Monitor
        With a threshold. Tests: :class:`residua.decide.NormThreshold` of the residual as a whole, of the members of a
        bank, or of groups, ``PeakThreshold``, ``CUSUM``, ``EWMA``, ``ChiSquared``, ``GLR``. Isolation:
        :class:`residua.decide.Directional`, :class:`residua.decide.Structured` for banks, or none.
    folder : path
        Where the files are to be.
    name : str, optional
        Of the files and in front of all names in them; from the plant when omitted.
    precision : {"double", "float"}
    missing : {"as monitored", "hold"}
        Of a Kalman filter: ``"hold"`` holds the last value of a missing one, as every other filter does.
    overwrite : bool
        Whether files of an earlier export may be replaced.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    SettingError
        If the code cannot represent the monitor (the message names the part), or an option has an invalid value.
    NotFittedError
        If the monitor has no threshold.
    DataError
        If the folder has something in it.

    See Also
    --------
    to_structured_text : For a programmable logic controller.

    Notes
    -----
    Assumes that samples come one by one, ``dt`` apart, and that the compiler rounds every product and every sum.
    The code follows rules of MISRA C:2012 as far as cppcheck can tell; it comes without a certificate.

    Examples
    --------
    >>> import tempfile
    >>> import residua as rs
    >>> plant = rs.Plant([[0.9]], [[0.1]], [[1.0]], dt=1, inputs=["valve"], outputs=["level"])
    >>> plant = plant.with_sensor_faults().with_noise(process=1e-6, measurement=1e-4)
    >>> monitor = rs.Monitor(rs.design.kalman_filter(plant))
    >>> folder = rs.export.to_c(monitor, tempfile.mkdtemp(), name="tank", missing="hold")
    >>> sorted(path.name for path in folder.iterdir())
    ['Makefile', 'selftest.c', 'tank.c', 'tank.h']
    """
    made = monitor_program(monitor, precision=precision_named(precision), missing=missing)
    prefix, one = _name(made, name), comparison(made)
    made = replace(made, notes=(*made.notes, *of_rounding(made, one)))
    return _written(
        folder,
        {
            f"{prefix}.h": header(made, prefix),
            f"{prefix}.c": code(made, prefix),
            "selftest.c": selftest(made, prefix, one),
            "Makefile": _MAKEFILE.replace("NAME", prefix),
        },
        overwrite=overwrite,
    )


def to_structured_text(
    monitor: Monitor,
    folder: str | os.PathLike[str],
    *,
    name: str | None = None,
    precision: str = "double",
    missing: str = "as monitored",
    overwrite: bool = False,
) -> Path:
    """Write a monitor as a function block in Structured Text (IEC 61131-3), ``NAME.st``.

    The block is called once for each sample. It is made of declarations, assignments, ``IF``, ``FOR``, ``ABS`` and
    ``SQRT`` alone, in ``LREAL`` or ``REAL``, and has the sums of :func:`to_c` in the same order.

    Parameters
    ----------
    monitor, folder, name, precision, missing, overwrite
        As of :func:`to_c`.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    SettingError, NotFittedError, DataError
        As :func:`to_c`.

    See Also
    --------
    to_c : For anything with a C compiler.

    Notes
    -----
    Assumes that the controller calls the block every ``dt`` seconds, and rounds as IEEE 754 says. It was run by an
    evaluator of the standard's text in tests, not by a controller's compiler.

    Examples
    --------
    >>> import tempfile
    >>> import residua as rs
    >>> plant = rs.Plant([[0.9]], [[0.1]], [[1.0]], dt=1, inputs=["valve"], outputs=["level"])
    >>> plant = plant.with_sensor_faults().with_noise(process=1e-6, measurement=1e-4)
    >>> monitor = rs.Monitor(rs.design.kalman_filter(plant))
    >>> folder = rs.export.to_structured_text(monitor, tempfile.mkdtemp(), name="tank", missing="hold")
    >>> (folder / "tank.st").read_text().splitlines()[-1]
    'END_FUNCTION_BLOCK'
    """
    made = monitor_program(monitor, precision=precision_named(precision), missing=missing)
    prefix = _name(made, name)
    return _written(folder, {f"{prefix}.st": function_block(made, prefix)}, overwrite=overwrite)


_MAKEFILE = """# gcc and clang: -std=c99 rounds every product before it is added, which keeps the bits of the monitor.
CC ?= cc
CFLAGS ?= -O2
STRICT = -std=c99 -ffp-contract=off -pedantic -Wall -Wextra

NAME.o: NAME.c NAME.h
\t$(CC) $(STRICT) $(CFLAGS) -c NAME.c -o NAME.o

selftest: selftest.c NAME.o
\t$(CC) $(STRICT) $(CFLAGS) selftest.c NAME.o -o selftest -lm

test: selftest
\t./selftest

clean:
\trm -f NAME.o selftest

.PHONY: test clean
"""


def _name(made: MonitorProgram, name: str | None) -> str:
    """Return the prefix of files and identifiers."""
    return identifier(made.name) if name is None else checked_identifier(name)


def _written(folder: str | os.PathLike[str], files: Mapping[str, str], *, overwrite: bool) -> Path:
    """Write files, each whole or not at all, if no other files are in the way."""
    path = Path(folder)
    if path.exists() and not path.is_dir():
        raise DataError(f"{path} is a file: name a folder")
    there = sorted(one.name for one in path.iterdir()) if path.is_dir() else []
    if there and not overwrite:
        raise DataError(f"{path} has {there[0]!r} in it: name another folder, or ask to overwrite (overwrite=True)")
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(f"{path}: {error.strerror or error}; name a folder that can be made") from error
    for one, text in files.items():
        with replacing(path / one) as partial:
            partial.write_text(text, encoding="utf-8")
    return path


__all__ = ["to_c", "to_structured_text"]
