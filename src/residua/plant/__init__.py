"""Plants: linear systems whose inputs have roles, from arrays, files and other packages."""

from typing import TYPE_CHECKING

from residua.facade import hand_on

if TYPE_CHECKING:
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
    from residua.robust.sets.linearisation import (
        Linearisation,
        uncertain_plant_from_parameters,
        uncertain_plant_from_plants,
    )
    from residua.robust.sets.uncertain_loop import close_loop, loop_parameters, residual_over_set
    from residua.robust.sets.uncertain_plant import Perturbation, UncertainParameter, UncertainPlant

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

hand_on(
    __name__,
    {
        "residua.plant.algebraic_equations": ("without_algebraic_equations",),
        "residua.plant.channels": ("Fault", "OperatingPoint"),
        "residua.plant.conversion": ("plant_from_state_space",),
        "residua.plant.disturbances": (
            "disturbance_from_parameters",
            "disturbance_from_perturbations",
            "disturbance_from_steady_states",
            "factor_disturbance",
            "quadratic_terms",
        ),
        "residua.plant.identification": ("Identification",),
        "residua.plant.input_output_conversion": ("input_output_from_plant",),
        "residua.plant.input_output_model": ("InputOutputModel",),
        "residua.plant.input_output_realization": ("Realization", "realize_input_output"),
        "residua.plant.plant": ("Plant",),
        "residua.plant.plant_file": ("load_plant", "loads_plant"),
        "residua.plant.plant_writer": ("dumps_plant", "save_plant"),
        "residua.plant.sensor_filter": ("augment_sensor_filter", "sensor_filter"),
        "residua.plant.transfer_functions": ("input_output_from_transfer_functions",),
        "residua.robust.sets.linearisation": (
            "Linearisation",
            "uncertain_plant_from_parameters",
            "uncertain_plant_from_plants",
        ),
        "residua.robust.sets.uncertain_loop": (
            "close_loop",
            "loop_parameters",
            "residual_over_set",
        ),
        "residua.robust.sets.uncertain_plant": ("Perturbation", "UncertainParameter", "UncertainPlant"),
    },
)
