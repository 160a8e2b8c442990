"""Plants: linear systems whose inputs have roles, from arrays, files and other packages."""

from residua.plant.algebraic_equations import without_algebraic_equations
from residua.plant.channels import Fault, OperatingPoint
from residua.plant.conversion import plant_from_state_space
from residua.plant.disturbances import (
    disturbance_from_parameters,
    disturbance_from_perturbations,
    disturbance_from_steady_states,
    factor_disturbance,
    quadratic_terms,
)
from residua.plant.plant import Plant
from residua.plant.plant_file import load_plant, loads_plant
from residua.plant.plant_writer import dumps_plant, save_plant
from residua.plant.sensor_filter import augment_sensor_filter, sensor_filter

__all__ = [
    "Fault",
    "OperatingPoint",
    "Plant",
    "augment_sensor_filter",
    "disturbance_from_parameters",
    "disturbance_from_perturbations",
    "disturbance_from_steady_states",
    "dumps_plant",
    "factor_disturbance",
    "load_plant",
    "loads_plant",
    "plant_from_state_space",
    "quadratic_terms",
    "save_plant",
    "sensor_filter",
    "without_algebraic_equations",
]
