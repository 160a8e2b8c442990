"""Model-based fault detection and isolation.

From a plant model and the list of what may fail to residual generators, alarms and the name of the faulty
component.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from residua import analysis, decide, design, errors, identify, library, linear, monitor, plant, validate
    from residua.analysis import coding, diagnosability
    from residua.design.observers.general_residual_generator import residual_generator_from_observer
    from residua.design.suggestion import suggest
    from residua.linear import StateSpace
    from residua.monitor import Diagnosis, Fleet, Monitor, RegimeMonitor, read_recording
    from residua.plant import InputOutputModel, Plant, UncertainPlant, load_plant

#: Each name is imported when it is first asked for: who runs a monitor waits for no design.
_ROOMS = ("analysis", "decide", "design", "errors", "identify", "library", "linear", "monitor", "plant", "validate")
#: They are not among the names that ``from residua import *`` brings.
_MORE_ROOMS = ("cluster", "export", "report", "testing")
_PLACES = {
    "Diagnosis": "monitor",
    "Fleet": "monitor",
    "InputOutputModel": "plant",
    "Monitor": "monitor",
    "Plant": "plant",
    "RegimeMonitor": "monitor",
    "StateSpace": "linear",
    "UncertainPlant": "plant",
    "diagnosability": "analysis",
    "load_plant": "plant",
    "read_recording": "monitor",
    "residual_generator_from_observer": "design.observers.general_residual_generator",
    "suggest": "design.suggestion",
}

__version__ = "0.1.0"

__all__ = [
    "Diagnosis",
    "Fleet",
    "InputOutputModel",
    "Monitor",
    "Plant",
    "RegimeMonitor",
    "StateSpace",
    "UncertainPlant",
    "analysis",
    "coding",
    "decide",
    "design",
    "diagnosability",
    "errors",
    "identify",
    "library",
    "linear",
    "load_plant",
    "monitor",
    "plant",
    "read_recording",
    "residual_generator_from_observer",
    "suggest",
    "validate",
]


def __getattr__(name: str) -> Any:
    if name in _PLACES:
        value = getattr(import_module(f"residua.{_PLACES[name]}"), name)
        globals()[name] = value
        return value
    if name == "coding":  # a module inside a room
        return import_module("residua.analysis.coding")
    if name in _ROOMS or name in _MORE_ROOMS:
        return import_module(f"residua.{name}")
    raise AttributeError(f"module 'residua' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, *_MORE_ROOMS})
