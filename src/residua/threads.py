"""One thread for the linear algebra inside designs: many small matrices, for which threads only wait."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, wraps
from threading import Lock
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")

_lock = Lock()
_inside = 0
_limiter: Any = None


@cache
def _controller() -> Any:
    import scipy.linalg  # noqa: F401  # brings a library of its own
    from threadpoolctl import ThreadpoolController  # looks at all libraries that are loaded

    return ThreadpoolController()


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit BLAS to one thread; the user's setting is restored when the last thread leaves."""
    global _inside, _limiter
    with _lock:
        if not _inside:
            _limiter = _controller().limit(limits=1, user_api="blas")
        _inside += 1
    try:
        yield
    finally:
        with _lock:
            _inside -= 1
            if not _inside:
                _limiter.restore_original_limits()


def in_one_thread(function: Callable[P, T]) -> Callable[P, T]:
    """Return a function that runs with one thread of BLAS."""

    @wraps(function)
    def limited(*args: P.args, **options: P.kwargs) -> T:
        with one_thread():
            return function(*args, **options)

    return limited
