"""Plants: linear systems whose inputs have roles, from arrays, files and other packages."""

from typing import TYPE_CHECKING

from residua.facade import names_from_above
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
from residua.plant.identification import Identification
from residua.plant.input_output_conversion import input_output_from_plant
from residua.plant.input_output_model import InputOutputModel
from residua.plant.input_output_realization import Realization, realize_input_output
from residua.plant.plant import Plant
from residua.plant.plant_file import load_plant, loads_plant
from residua.plant.plant_writer import dumps_plant, save_plant
from residua.plant.sensor_filter import augment_sensor_filter, sensor_filter
from residua.plant.transfer_functions import input_output_from_transfer_functions

if TYPE_CHECKING:
    from residua.robust.sets.linearisation import (
        Linearisation,
        uncertain_plant_from_parameters,
        uncertain_plant_from_plants,
    )
    from residua.robust.sets.perturbation import Perturbation, UncertainParameter
    from residua.robust.sets.uncertain_loop import close_loop, estimator_residual, loop_parameters, residual_over_set
    from residua.robust.sets.uncertain_plant import UncertainPlant

__all__ = [
    "Fault",
    "Identification",
    "InputOutputModel",
    "Linearisation",
    "OperatingPoint",
    "Perturbation",
    "Plant",
    "Realization",
    "UncertainParameter",
    "UncertainPlant",
    "augment_sensor_filter",
    "close_loop",
    "disturbance_from_parameters",
    "disturbance_from_perturbations",
    "disturbance_from_steady_states",
    "dumps_plant",
    "estimator_residual",
    "factor_disturbance",
    "input_output_from_plant",
    "input_output_from_transfer_functions",
    "load_plant",
    "loads_plant",
    "loop_parameters",
    "plant_from_state_space",
    "quadratic_terms",
    "realize_input_output",
    "residual_over_set",
    "save_plant",
    "sensor_filter",
    "uncertain_plant_from_parameters",
    "uncertain_plant_from_plants",
    "without_algebraic_equations",
]

__getattr__ = names_from_above(
    __name__,
    {
        "Perturbation": "residua.robust.sets.perturbation",
        "UncertainParameter": "residua.robust.sets.perturbation",
        "Linearisation": "residua.robust.sets.linearisation",
        "uncertain_plant_from_parameters": "residua.robust.sets.linearisation",
        "uncertain_plant_from_plants": "residua.robust.sets.linearisation",
        "close_loop": "residua.robust.sets.uncertain_loop",
        "estimator_residual": "residua.robust.sets.uncertain_loop",
        "loop_parameters": "residua.robust.sets.uncertain_loop",
        "residual_over_set": "residua.robust.sets.uncertain_loop",
        "UncertainPlant": "residua.robust.sets.uncertain_plant",
    },
)
