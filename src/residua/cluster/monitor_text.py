"""A monitor on its way to a worker: its record in JSON, from which the worker builds an equal monitor."""

from __future__ import annotations

from functools import lru_cache

from residua.errors import NotFittedError, SettingError
from residua.json_files import check_checksum, dumps, loads
from residua.monitor.monitor import Monitor
from residua.monitor.saving import monitor_from, monitor_out
from residua.visible import echo

_NAME = "the monitor that came"


def text_of_monitor(monitor: Monitor) -> str:
    """Return a monitor as text for a worker: its file, without its state.

    Parameters
    ----------
    monitor : Monitor
        With a threshold. A test or an isolation of a user's own must be imported on the workers too.

    Raises
    ------
    NotFittedError
        If it has no threshold.

    Examples
    --------
    >>> import residua as rs
    >>> from residua.cluster import monitor_of_text, text_of_monitor
    >>> plant = rs.Plant([[0.9]], [[0.1]], [[1.0]], dt=1).with_noise(process=1e-4, measurement=1e-2)
    >>> monitor = rs.Monitor(rs.design.kalman_filter(plant))
    >>> monitor_of_text(text_of_monitor(monitor)).threshold == monitor.threshold
    True
    """
    if not isinstance(monitor, Monitor):
        raise SettingError(f"a cluster runs a monitor, got {echo(monitor)}")
    if not monitor.is_fitted:
        raise NotFittedError(f"the monitor of a cluster needs a threshold: {monitor.test.remedy}")
    return dumps(monitor_out(monitor) | {"state": None})


@lru_cache(maxsize=16)
def monitor_of_text(text: str) -> Monitor:
    """Return the monitor of a text, built once in a process; its own state is not to be used."""
    content = loads(text.encode(), _NAME)
    check_checksum(content, _NAME)
    monitor = monitor_from(content, _NAME)
    if not monitor.is_fitted:
        raise NotFittedError("the monitor that came has no threshold")
    return monitor


__all__ = ["monitor_of_text", "text_of_monitor"]
