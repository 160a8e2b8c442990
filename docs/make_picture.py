"""Make _static/report.png: the report page of the README's example, as a browser shows it.

``make docs`` runs it where Chromium (or Google Chrome) is installed. It needs Pillow, which matplotlib brings. The picture is
the upper part of the page, in 256 colours to keep it small. It carries a digest of all that it was made from, and is made
anew only when that changes.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image, PngImagePlugin

DOCS = Path(__file__).resolve().parent
WIDTH, HEIGHT, COLOURS, LARGEST = 1240, 1535, 256, 250_000
KEY = "made from"


def readme_example() -> str:
    """Return the Python code of the README."""
    text = (DOCS.parent / "README.md").read_text(encoding="utf-8")
    return re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)[0]


def sources() -> str:
    """Return a digest of the example, what it prints, and the code of the report page."""
    readme = (DOCS.parent / "README.md").read_text(encoding="utf-8")
    digest = hashlib.sha256("".join(re.findall(r"```(?:python|text)\n(.*?)```", readme, flags=re.DOTALL)).encode())
    report = DOCS.parent / "src" / "residua" / "report"
    for path in sorted(p for p in report.rglob("*") if p.suffix in {".py", ".js", ".css", ".html"}):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def main() -> None:
    """Run the example, photograph its page, and write the picture."""
    target = DOCS / "_static" / "report.png"
    stamp = sources()
    with Image.open(target) as made:
        if made.info.get(KEY) == stamp:
            return
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if browser is None:
        print(f"{target.name} is older than the report page: install chromium to make it anew")
        return
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        exec(compile(readme_example(), "README.md", "exec"), {"__name__": "readme"})
        sandbox = ["--no-sandbox"] if os.name == "posix" and os.geteuid() == 0 else []
        command = [browser, "--headless", *sandbox, "--disable-gpu", "--hide-scrollbars"]
        command += [
            f"--user-data-dir={folder}/profile",
            f"--window-size={WIDTH},{HEIGHT}",
            "--virtual-time-budget=2000",
        ]
        command += [f"--screenshot={folder}/page.png", Path("report.html").absolute().as_uri()]
        subprocess.run(command, check=True, capture_output=True, timeout=120)
        with Image.open("page.png") as page:
            small = page.convert("RGB").quantize(COLOURS, kmeans=2, dither=Image.Dither.NONE)
            marks = PngImagePlugin.PngInfo()
            marks.add_text(KEY, stamp)
            small.save(target, optimize=True, pnginfo=marks)
    size = target.stat().st_size
    print(f"{target.relative_to(DOCS.parent)}: {size / 1000:.0f} kB")
    if size > LARGEST:
        sys.exit(f"larger than {LARGEST / 1000:.0f} kB: fewer colours or a smaller window")


if __name__ == "__main__":
    main()
