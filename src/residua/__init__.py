"""Model-based fault detection and isolation.

From a plant model and the list of what may fail to residual generators, alarms and the name of the faulty
component.
"""

from importlib import import_module
from types import ModuleType

from residua import analysis, decide, design, errors, identify, library, linear, monitor, plant, validate
from residua.analysis import coding, diagnosability
from residua.design.observers.general_residual_generator import residual_generator_from_observer
from residua.design.suggestion import suggest
from residua.linear import StateSpace
from residua.monitor import Diagnosis, Fleet, Monitor, RegimeMonitor, read_recording
from residua.plant import InputOutputModel, Plant, UncertainPlant, load_plant

_LAZY = ("cluster", "export", "report", "testing")  # they are not needed to run a monitor, and slower to import

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


def __getattr__(name: str) -> ModuleType:
    if name in _LAZY:
        return import_module(f"residua.{name}")
    raise AttributeError(f"module 'residua' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *_LAZY])
