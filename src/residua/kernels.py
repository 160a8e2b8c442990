"""Compiled parts of the package, and whether they are in use."""

from __future__ import annotations

import importlib
import os
import warnings
from typing import Any

_MISSING = (
    "residua was installed without its compiled kernels ({}): monitors give the same results in NumPy, but take 300 to"
    " 600 times as long. Install a wheel, or install a C compiler and then residua again; set RESIDUA_NO_COMPILED=1 to"
    " run without the kernels and without this warning"
)
_is_warned = False


def kernel(name: str) -> Any:
    """Return a compiled module of the package.

    ``None`` where the environment variable ``RESIDUA_NO_COMPILED`` is ``1``, or, after one warning, where the package
    was built without a C compiler. The caller then runs in Python, with the same bits.
    """
    global _is_warned
    if os.environ.get("RESIDUA_NO_COMPILED") == "1":
        return None
    try:
        return importlib.import_module(name)
    except ImportError as error:
        if not _is_warned:
            _is_warned = True
            warnings.warn(_MISSING.format(error), RuntimeWarning, stacklevel=2)
        return None
