"""A monitor as a Functional Mock-up Unit (FMI 2.0 and 3.0), for co-simulation."""

from __future__ import annotations

import hashlib
import os
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from residua.errors import SettingError
from residua.export.c99 import code, header
from residua.export.fmu_binary import OPTIONS, Binary, binary_of, packed
from residua.export.fmu_description import build_description, documentation, fmi2_description, fmi3_description
from residua.export.fmu_variables import FMUVariable, fmu_variables
from residua.export.identifiers import checked_identifier, identifier
from residua.export.monitor_program import MonitorProgram, monitor_program
from residua.export.one_file import file_for, named_after
from residua.files import replacing
from residua.monitor import Monitor
from residua.visible import echo

_VERSIONS = ("2.0", "3.0")
#: When the files in a unit were made: the same monitor gives the same bytes.
_EPOCH = (1980, 1, 1, 0, 0, 0)


class FMU(NamedTuple):
    """Result of :func:`to_fmu`.

    Attributes
    ----------
    path : Path
        The file.
    platform : str or None
        Platform of the binary inside; ``None`` if there are only sources.
    why : str
        Why there is no binary; empty where there is one.
    renamed : dict of str to str
        The signals that have another name in the unit than in the plant, with that name.
    """

    path: Path
    platform: str | None
    why: str
    renamed: dict[str, str]


def to_fmu(
    monitor: Monitor,
    path: str | os.PathLike[str],
    *,
    version: str = "3.0",
    name: str | None = None,
    missing: str = "as monitored",
    binary: bool | None = None,
    overwrite: bool = False,
) -> FMU:
    """Write a monitor as a Functional Mock-up Unit for co-simulation, ``NAME.fmu``.

    Its inputs are the signals of the plant, by their names; its outputs are ``statistic``, ``residual_1`` and so on,
    ``known``, ``decided``, ``alarm``, and where faults are named ``scored``, ``score_1`` and so on, and ``best``.
    Inside are the C code of :func:`to_c` in double precision with the functions of FMI, and a binary of it for the
    machine that wrote the unit.

    A sample is taken at the start time t0 and every dt from there on: by the communication step that starts at
    t0 + k dt, of the inputs that are set then. After that step the outputs are those of :meth:`residua.Monitor.step` on
    that sample; inputs set later do not affect them. A step that passes a sample (one longer than dt, or one that
    begins before a sample and ends after it) is refused, since the inputs of that sample are not known; with the
    parameter ``hold_inputs`` it takes the inputs of its beginning.

    Guaranteed: the bits of the monitor. Before a binary is packed, the self-test of :func:`to_c` is compiled by the
    same compiler with the same options, and has to pass.

    Parameters
    ----------
    monitor : Monitor
        With a threshold; :func:`to_c` lists what can be exported.
    path : path
        A file that ends in ``.fmu``, or a folder for ``NAME.fmu``.
    version : {"2.0", "3.0"}
    name : str, optional
        The model's identifier; from the file, else from the plant, when omitted.
    missing : {"as monitored", "hold"}
        As of :func:`to_c`.
    binary : bool, optional
        ``False`` for sources only, ``True`` for an error where there is no C compiler. When omitted there is a binary
        where there is a compiler: ``$CC``, or ``cc``, ``gcc``, ``clang``.
    overwrite : bool
        Whether a file that is there may be replaced.

    Returns
    -------
    FMU
        The path, the platform of the binary or the reason for its absence, and the changed names.

    Raises
    ------
    SettingError
        If the unit cannot represent the monitor, an option has an invalid value, or a binary is requested and
        there is no compiler, or it fails.
    AccuracyError
        If the compiled code differs from the monitor in any bit.
    NotFittedError
        If the monitor has no threshold.
    DataError
        If the file is there, or its folder cannot be made.

    See Also
    --------
    to_c : The code alone.

    Notes
    -----
    Assumes that the importer calls every step once, and sets missing values to NaN. Instances share nothing; the state
    of one can be read, set and kept as bytes, which are refused where they are those of another monitor. It comes
    without a certificate.

    References
    ----------
    Modelica Association: Functional Mock-up Interface Specification, versions 2.0.4 and 3.0.1.

    Examples
    --------
    >>> import tempfile, zipfile
    >>> import residua as rs
    >>> plant = rs.Plant([[0.9]], [[0.1]], [[1.0]], dt=1, inputs=["valve"], outputs=["level"])
    >>> plant = plant.with_sensor_faults().with_noise(process=1e-6, measurement=1e-4)
    >>> monitor = rs.Monitor(rs.design.kalman_filter(plant))
    >>> made = rs.export.to_fmu(monitor, tempfile.mkdtemp(), name="tank", missing="hold", binary=False)
    >>> print(made.path.name, made.why)
    tank.fmu sources only, as asked
    >>> "sources/tank.c" in zipfile.ZipFile(made.path).namelist()
    True
    """
    if version not in _VERSIONS:
        raise SettingError(f"version must be {' or '.join(map(repr, _VERSIONS))}, got {echo(version)}")
    if binary not in (None, True, False):
        raise SettingError(f"binary must be True, False or None, got {echo(binary)}")
    made = monitor_program(monitor, missing=missing)
    prefix = (named_after(path, ".fmu") or identifier(made.name)) if name is None else checked_identifier(name)
    target = file_for(path, f"{prefix}.fmu", overwrite=overwrite)
    return pack(made, target, prefix, version, binary)


def pack(made: MonitorProgram, target: Path, prefix: str, version: str, binary: bool | None) -> FMU:
    """Write a program as a unit; parameters as of :func:`to_fmu`."""
    variables = fmu_variables(made)
    sources = _sources(made, variables, prefix, version)
    built = (
        Binary(None, None, "sources only, as asked") if binary is False else binary_of(made, sources, prefix, version)
    )
    if binary and built.content is None:
        raise SettingError(f"there is no binary to put into the unit: {built.why}")
    files = _files(made, variables, prefix, version, sources, built)
    with replacing(target) as partial:
        _archive(partial, files)
    renamed = {one.original: one.name for one in variables if one.original not in ("", one.name)}
    return FMU(target, built.platform, built.why, renamed)


def _files(
    made: MonitorProgram,
    variables: list[FMUVariable],
    prefix: str,
    version: str,
    sources: Mapping[str, str],
    built: Binary,
) -> dict[str, bytes]:
    """Return the content of the unit."""
    token, compiled = _token(sources), [one for one in sources if one.endswith(".c")]
    if version == "2.0":
        about = fmi2_description(made, variables, prefix, token, compiled)
    else:
        about = fmi3_description(made, variables, prefix, token)
    of_binary = (
        f"The binary inside is for {built.platform}." if built.content else f"There is no binary inside: {built.why}."
    )
    texts = {
        "modelDescription.xml": about,
        "documentation/index.html": documentation(made, variables, (*made.notes, of_binary)),
        "documentation/licenses/fmi_headers.txt": packed("LICENSE.txt"),
        **{f"sources/{one}": text for one, text in sources.items()},
    }
    if version == "3.0":
        texts["sources/buildDescription.xml"] = build_description(prefix, compiled, " ".join(OPTIONS))
    files = {one: text.encode() for one, text in texts.items()}
    if built.content is not None:
        files[f"binaries/{built.platform}/{prefix}{built.ending}"] = built.content
    return files


def _sources(made: MonitorProgram, variables: list[FMUVariable], prefix: str, version: str) -> dict[str, str]:
    """Return the C sources by their names; the code of the unit contains a hash of all of them."""
    of_version = f"fmi{version[0]}.c"
    sources = {
        f"{prefix}.h": header(made, prefix),
        f"{prefix}.c": code(made, prefix),
        f"{prefix}_fmu.h": packed("fmu.h").replace("PREFIX", prefix),
        f"{prefix}_fmu.c": packed("fmu.c").replace("PREFIX", prefix),
        of_version: packed(of_version).replace("PREFIX", prefix),
    }
    sources[f"{prefix}_model.h"] = _model_header(made, variables, prefix, sources)
    return sources


def _model_header(made: MonitorProgram, variables: list[FMUVariable], prefix: str, sources: Mapping[str, str]) -> str:
    """Return the constants of this monitor for the code of the unit."""
    digest = hashlib.sha256()
    for text in (*sources.values(), *map(repr, variables)):
        digest.update(text.encode())
    hexadecimal = digest.hexdigest()
    groups = "-".join(hexadecimal[a:b] for a, b in ((0, 8), (8, 12), (12, 16), (16, 20), (20, 32)))
    start = ", ".join(repr(float(one)) for one in made.specification.offset)
    (threshold,) = (one.start for one in variables if one.role == "local")
    constants = {
        "INPUT_COUNT": f"{len(made.inputs)}",
        "CHANNELS": f"{len(made.inputs) + len(made.outputs)}U",
        "RESIDUALS": f"{made.program.names['residual'].size}U",
        "SCORES": f"{sum(one.name.startswith('score_') for one in variables)}U",
        "PARTS": f"{len(made.parts)}U",
        "CODED_PARTS": f"{len(made.parts) if 'code' in made.program.names else 0}U",
        "DT": repr(made.dt),
        "DT_TEXT": f'"{made.dt:g}"',
        "THRESHOLD": repr(threshold),
        "START": f"{{{start}}}",
        "TOKEN": f'"{{{groups}}}"',
        "FINGERPRINT": f"0x{hexadecimal[32:48].upper()}U",
    }
    lines = [
        "/* Constants of this monitor for the code of the unit. */",
        f"#ifndef {prefix}_MODEL_H",
        f"#define {prefix}_MODEL_H",
        "",
        f'#include "{prefix}.h"',
        "",
        *(f"#define {prefix}_{one} {text}" for one, text in constants.items()),
        "",
        "#endif",
    ]
    return "\n".join(lines) + "\n"


def _token(sources: Mapping[str, str]) -> str:
    """Return the token that links code and description."""
    (model,) = (text for one, text in sources.items() if one.endswith("_model.h"))
    (line,) = (one for one in model.splitlines() if "_TOKEN " in one)
    return line.split('"')[1]


def _archive(path: Path, files: Mapping[str, bytes]) -> None:
    """Write files into an archive, reproducibly."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for one, content in files.items():
            entry = zipfile.ZipInfo(one, _EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, content)


__all__ = ["FMU", "pack", "to_fmu"]
