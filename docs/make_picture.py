"""Make _static/report.png: the report page of the README's example, as a browser shows it.

Run it after a change of the report page: ``python docs/make_picture.py``. It needs Chromium (or Google Chrome) and
Pillow, which matplotlib brings. The picture is the upper part of the page, in 256 colours to keep it small.
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

DOCS = Path(__file__).resolve().parent
WIDTH, HEIGHT, COLOURS, LARGEST = 1240, 1535, 256, 250_000


def readme_example() -> str:
    """Return the Python code of the README."""
    text = (DOCS.parent / "README.md").read_text(encoding="utf-8")
    return re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)[0]


def browser() -> str:
    """Return the path of a Chromium."""
    for name in ("chromium", "chromium-browser", "google-chrome"):
        found = shutil.which(name)
        if found:
            return found
    raise SystemExit("needs chromium, chromium-browser or google-chrome")


def main() -> None:
    """Run the example, photograph its page, and write the picture."""
    target = DOCS / "_static" / "report.png"
    target.parent.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        exec(compile(readme_example(), "README.md", "exec"), {"__name__": "readme"})
        sandbox = ["--no-sandbox"] if os.name == "posix" and os.geteuid() == 0 else []
        command = [browser(), "--headless", *sandbox, "--disable-gpu", "--hide-scrollbars"]
        command += [
            f"--user-data-dir={folder}/profile",
            f"--window-size={WIDTH},{HEIGHT}",
            "--virtual-time-budget=2000",
        ]
        command += [f"--screenshot={folder}/page.png", Path("report.html").absolute().as_uri()]
        subprocess.run(command, check=True, capture_output=True, timeout=120)
        with Image.open("page.png") as page:
            small = page.convert("RGB").quantize(COLOURS, kmeans=2, dither=Image.Dither.NONE)
            small.save(target, optimize=True)
    size = target.stat().st_size
    print(f"{target.relative_to(DOCS.parent)}: {size / 1000:.0f} kB")
    if size > LARGEST:
        sys.exit(f"larger than {LARGEST / 1000:.0f} kB: fewer colours or a smaller window")


if __name__ == "__main__":
    main()
