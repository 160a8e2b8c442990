"""Install what ``python -m build`` made where there is no compiler, and run the smoke test there: ``make dist``.

The wheel must bring the compiled kernel, the source distribution must do without one, and both must give the same
residuals to the last bit.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from pathlib import Path

SMOKE = Path(__file__).with_name("smoke.py")
COMPILERS = ("cc", "gcc", "c++", "g++", "clang", "cl")


#: The compiled modules.
KERNELS = ("residua/linear/systems/_recursion", "residua/monitor/_fused", "residua/live/_rows")


def contents(distribution: Path) -> list[str]:
    """Return the files of a wheel or a source distribution, without the folder around the latter."""
    if distribution.suffix == ".whl":
        with zipfile.ZipFile(distribution) as archive:
            return archive.namelist()
    with tarfile.open(distribution) as archive:
        return [name.partition("/")[2] for name in archive.getnames()]


def complaints(distribution: Path) -> list[str]:
    """Return what should not be in a distribution, or should and is not."""
    names = contents(distribution)
    built = [name for name in names if name.endswith((".so", ".pyd", ".pyc", ".o"))]
    if distribution.suffix == ".whl":
        wanted = [r"residua/__init__\.py", r"residua/py\.typed", r".*/licenses/LICENSE"]
        wanted += [r"residua/export/fmi/fmu\.c", r"residua/export/fmi/headers/.+\.h", r".*/licenses/.*fmi/LICENSE\.txt"]
        wanted += [r"residua/report/static/.+\.js", *(rf"{kernel}\.(abi3\.so|pyd)" for kernel in KERNELS)]
        unwanted = [name for name in names if not name.startswith(("residua/", "residua-"))]
        unwanted += [name for name in built if not name.startswith(tuple(f"{kernel}." for kernel in KERNELS))]
        if "-cp311-abi3-" not in distribution.name:
            unwanted.append("a tag other than cp311-abi3, by which each Python would need a wheel of its own")
    else:
        wanted = [
            *(rf"src/{kernel}\.c" for kernel in KERNELS),
            r"src/residua/linear/systems/_filter\.h",
            r"setup\.py",
            r"LICENSE",
            r"CHANGELOG\.md",
            r"README\.md",
        ]
        wanted += [r"tests/smoke\.py", r"docs/conf\.py", r"examples/.*\.toml"]
        unwanted = built
    missing = [pattern for pattern in wanted if not any(re.fullmatch(pattern, name) for name in names)]
    return [f"missing: {pattern}" for pattern in missing] + [f"not wanted: {name}" for name in unwanted]


def without_compiler(binaries: Path) -> dict[str, str]:
    """Return an environment in which nothing compiles: only an environment's own programs are on the path."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "CONDA", "VIRTUAL"))}
    environment = kept | {"PATH": str(binaries), "CC": "false", "CXX": "false"}
    present = [name for name in COMPILERS if shutil.which(name, path=environment["PATH"])]
    if present:
        raise SystemExit(f"{binaries} has compilers, so that nothing is shown: {', '.join(present)}")
    return environment


def smoke(distribution: Path, python: str) -> tuple[str, str]:
    """Install into a bare environment, run the smoke test; return how filters ran there and the residuals' hash."""
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([python, "-m", "venv", f"{folder}/bare"], check=True)
        binaries = Path(folder) / "bare" / ("Scripts" if os.name == "nt" else "bin")
        environment = without_compiler(binaries)
        bare = str(binaries / "python")
        install = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check", str(distribution.resolve())]
        subprocess.run([bare, *install], check=True, env=environment, cwd=folder)
        script = shutil.copy(SMOKE, folder)
        printed = subprocess.run([bare, "-I", script], env=environment, cwd=folder, capture_output=True, text=True)
    if printed.returncode:
        raise SystemExit(f"{distribution.name}: the smoke test failed\n{printed.stdout}{printed.stderr}")
    *_, kernel, digest = printed.stdout.split()
    return kernel, digest


def main() -> None:
    """Look into the distributions, install them, and compare."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folder", type=Path, help="with one wheel and one source distribution")
    parser.add_argument("--python", default=sys.executable, help="that the bare environments are made of")
    options = parser.parse_args()
    ((wheel,), (source,)) = (sorted(options.folder.glob(pattern)) for pattern in ("*.whl", "*.tar.gz"))
    digests = set()
    for distribution, expected in ((wheel, "compiled"), (source, "numpy")):
        if wrong := complaints(distribution):
            raise SystemExit("\n".join([f"{distribution.name}:", *wrong]))
        kernel, digest = smoke(distribution, options.python)
        print(f"{distribution.name}: installed without a compiler; the smoke test ran, {kernel}, residuals {digest}")
        if kernel != expected:
            raise SystemExit(f"expected {expected}")
        digests.add(digest)
    if len(digests) > 1:
        raise SystemExit("the compiled kernel and NumPy give different residuals")


if __name__ == "__main__":
    main()
