"""Model-based fault detection and isolation.

From a plant model and the list of what may fail to residual generators, alarms and the name of the faulty
component.
"""

from residua import analysis, decide, design, errors, library, linear, monitor, plant
from residua.analysis import diagnosability
from residua.linear import StateSpace
from residua.monitor import Diagnosis, Monitor, read_recording
from residua.plant import Plant, load_plant

__version__ = "0.1.0"

__all__ = [
    "Diagnosis",
    "Monitor",
    "Plant",
    "StateSpace",
    "analysis",
    "decide",
    "design",
    "diagnosability",
    "errors",
    "library",
    "linear",
    "load_plant",
    "monitor",
    "plant",
    "read_recording",
]
