"""Plants: linear systems whose inputs have roles, from arrays, files and other packages."""

from residua.plant.disturbances import (
    disturbance_from_parameters,
    disturbance_from_perturbations,
    disturbance_from_steady_states,
    factor_disturbance,
    quadratic_terms,
)
from residua.plant.plant import Fault, OperatingPoint, Plant

__all__ = [
    "Fault",
    "OperatingPoint",
    "Plant",
    "disturbance_from_parameters",
    "disturbance_from_perturbations",
    "disturbance_from_steady_states",
    "factor_disturbance",
    "quadratic_terms",
]
