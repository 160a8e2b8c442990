"""The compiled parts of the package, and whether they are in use."""

from __future__ import annotations

import importlib
import os
from typing import Any


def kernel(name: str) -> Any:
    """Return a compiled module of the package.

    ``None`` where the package was built without a C compiler, or the environment variable ``RESIDUA_NO_COMPILED`` is
    ``1``: what calls it runs in Python then, with the same bits.
    """
    if os.environ.get("RESIDUA_NO_COMPILED") == "1":
        return None
    try:
        return importlib.import_module(name)
    except ImportError:
        return None
