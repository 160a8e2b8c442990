"""The binary of a Functional Mock-up Unit, by an available C compiler; checked by the self-test first."""

from __future__ import annotations

import os
import platform as machine
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import NamedTuple

from residua.errors import AccuracyError, SettingError
from residua.export.monitor_program import MonitorProgram
from residua.export.selftest import comparison, selftest
from residua.visible import visible

#: Products are rounded before they are added, which keeps the bits of the monitor.
OPTIONS = ("-std=c99", "-ffp-contract=off")
_SHARED = ("-O2", "-fPIC", "-shared", "-fvisibility=hidden")
_COMPILERS = ("cc", "gcc", "clang")
_ENDINGS = {"linux": ".so", "darwin": ".dylib", "windows": ".dll"}
#: Folders of binaries in FMI 2.0, which has no name for other machines than these.
_FMI2 = {"linux": "linux64", "darwin": "darwin64", "windows": "win64"}
_PROCESSORS = {"x86_64": "x86_64", "amd64": "x86_64", "aarch64": "aarch64", "arm64": "aarch64"}
_HEADERS = {
    "2.0": ("fmi2FunctionTypes.h", "fmi2Functions.h", "fmi2TypesPlatform.h"),
    "3.0": ("fmi3FunctionTypes.h", "fmi3Functions.h", "fmi3PlatformTypes.h"),
}
#: Seconds that a compiler may take.
_PATIENCE = 300


class Binary(NamedTuple):
    """A shared library, or the reason for its absence.

    Attributes
    ----------
    content : bytes or None
    platform : str or None
        The folder of binaries that it goes to.
    why : str
        Why there is none.
    ending : str
    """

    content: bytes | None
    platform: str | None
    why: str
    ending: str = ""


def packed(name: str) -> str:
    """Return a file of the package: the code of a unit, or a header of FMI."""
    return resources.files("residua.export").joinpath("fmi", *name.split("/")).read_text(encoding="utf-8")


def platform_of(version: str) -> tuple[str, str] | None:
    """Return the folder and the ending of binaries for this machine; ``None`` if the version has no name for it."""
    system, processor = machine.system().lower(), _PROCESSORS.get(machine.machine().lower())
    if system not in _ENDINGS or processor is None or sys.maxsize < 2**32:
        return None
    if version == "2.0":
        named = processor == "x86_64" or system == "darwin"
        return (_FMI2[system], _ENDINGS[system]) if named else None
    return f"{processor}-{system}", _ENDINGS[system]


def compiler_at_hand() -> list[str] | None:
    """Return the command of the C compiler: ``$CC``, or one by its usual name; ``None`` if there is none."""
    asked = shlex.split(os.environ.get("CC", ""))
    for one in (asked, *([name] for name in _COMPILERS)):
        if one and shutil.which(one[0]):
            return one
        if one and one is asked:
            return None  # the requested compiler does not exist: no other is used in its place
    return None


def binary_of(made: MonitorProgram, sources: Mapping[str, str], prefix: str, version: str) -> Binary:
    """Return the binary of a unit.

    Parameters
    ----------
    made : MonitorProgram
    sources : mapping of str to str
        Files of C by their names.
    prefix : str
    version : {"2.0", "3.0"}

    Raises
    ------
    SettingError
        If the compiler fails.
    AccuracyError
        If the compiled code differs from the monitor in any bit.
    """
    place, compiler = platform_of(version), compiler_at_hand()
    if place is None:
        return Binary(None, None, f"FMI {version} has no name for {sysconfig.get_platform()}")
    if compiler is None:
        return Binary(None, None, "there is no C compiler (cc, gcc, clang, or what CC names)")
    with tempfile.TemporaryDirectory() as held:
        folder, one = Path(held), comparison(made)
        for name, text in sources.items():
            (folder / name).write_text(text, encoding="utf-8")
        for name in _HEADERS[version]:
            (folder / name).write_text(packed(f"headers/{name}"), encoding="utf-8")
        (folder / "selftest.c").write_text(selftest(made, prefix, one), encoding="utf-8")
        _check(compiler, folder, prefix)
        library = f"{prefix}{place[1]}"
        files = [name for name in sources if name.endswith(".c")]
        _run([*compiler, *OPTIONS, *_SHARED, *files, "-o", library, "-lm"], folder)
        return Binary((folder / library).read_bytes(), place[0], "", place[1])


def _check(compiler: Sequence[str], folder: Path, prefix: str) -> None:
    """Raise unless the self-test passes, compiled in the same way."""
    program = folder / ("selftest.exe" if machine.system() == "Windows" else "selftest")
    _run([*compiler, *OPTIONS, "-O2", "selftest.c", f"{prefix}.c", "-o", program.name, "-lm"], folder)
    done = subprocess.run([program], cwd=folder, capture_output=True, text=True, check=False, timeout=_PATIENCE)
    if done.returncode != 0:
        raise AccuracyError(
            f"what the compiler {' '.join(compiler)} makes has not the bits of the monitor "
            f"({visible(done.stdout.strip())}): it must round every product and every sum; take another one (CC=...), "
            "or export sources only"
        )


def _run(command: Sequence[str], folder: Path) -> None:
    """Run a compiler, and raise its errors."""
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=_PATIENCE)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise SettingError(f"the C compiler {command[0]} does not run: {error}; or export sources only") from error
    if done.returncode != 0:
        said = visible(done.stderr.strip())[:2000]
        raise SettingError(
            f"the C compiler fails ({' '.join(command)}): {said}; take another one (CC=...), or export sources only"
        )


__all__ = ["OPTIONS", "Binary", "binary_of", "compiler_at_hand", "packed", "platform_of"]
