"""Model-based fault detection and isolation.

From a plant model and a list of faults to residual generators, alarms and the name of the faulty component.
"""

from typing import TYPE_CHECKING

from residua.facade import hand_on

if TYPE_CHECKING:
    from residua import analysis, decide, design, errors, identify, library, linear, monitor, plant, validate
    from residua.analysis import coding, diagnosability
    from residua.design.observers.general_residual_generator import residual_generator_from_observer
    from residua.design.suggestion import suggest
    from residua.linear import StateSpace
    from residua.monitor import Diagnosis, Fleet, Learnt, Monitor, RegimeMonitor, learn, read_recording
    from residua.plant import InputOutputModel, Plant, UncertainPlant, load_plant

__version__ = "0.1.0"

__all__ = [
    "Diagnosis",
    "Fleet",
    "InputOutputModel",
    "Learnt",
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
    "learn",
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

hand_on(
    __name__,
    {
        "residua.analysis": ("diagnosability",),
        "residua.design.observers.general_residual_generator": ("residual_generator_from_observer",),
        "residua.design.suggestion": ("suggest",),
        "residua.linear": ("StateSpace",),
        "residua.monitor": ("Diagnosis", "Fleet", "Learnt", "Monitor", "RegimeMonitor", "learn", "read_recording"),
        "residua.plant": ("InputOutputModel", "Plant", "UncertainPlant", "load_plant"),
    },
    [
        *("residua.analysis", "residua.analysis.coding", "residua.cluster", "residua.decide", "residua.design"),
        *("residua.errors", "residua.export", "residua.identify", "residua.library", "residua.linear"),
        *("residua.monitor", "residua.plant", "residua.report", "residua.testing", "residua.validate"),
    ],
)
