from residua.plant.algebraic_equations import without_algebraic_equations as without_algebraic_equations
from residua.plant.channels import Fault as Fault, OperatingPoint as OperatingPoint
from residua.plant.conversion import plant_from_state_space as plant_from_state_space
from residua.plant.disturbances import (
    disturbance_from_parameters as disturbance_from_parameters,
    disturbance_from_perturbations as disturbance_from_perturbations,
    disturbance_from_steady_states as disturbance_from_steady_states,
    factor_disturbance as factor_disturbance,
    quadratic_terms as quadratic_terms,
)
from residua.plant.identification import Identification as Identification
from residua.plant.input_output_conversion import input_output_from_plant as input_output_from_plant
from residua.plant.input_output_model import InputOutputModel as InputOutputModel
from residua.plant.input_output_realization import (
    Realization as Realization,
    realize_input_output as realize_input_output,
)
from residua.plant.plant import Plant as Plant
from residua.plant.plant_file import load_plant as load_plant, loads_plant as loads_plant
from residua.plant.plant_writer import dumps_plant as dumps_plant, save_plant as save_plant
from residua.plant.sensor_filter import augment_sensor_filter as augment_sensor_filter, sensor_filter as sensor_filter
from residua.plant.transfer_functions import (
    input_output_from_transfer_functions as input_output_from_transfer_functions,
)
from residua.robust.sets.linearisation import (
    Linearisation as Linearisation,
    uncertain_plant_from_parameters as uncertain_plant_from_parameters,
    uncertain_plant_from_plants as uncertain_plant_from_plants,
)
from residua.robust.sets.uncertain_loop import (
    close_loop as close_loop,
    loop_parameters as loop_parameters,
    residual_over_set as residual_over_set,
)
from residua.robust.sets.uncertain_plant import (
    Perturbation as Perturbation,
    UncertainParameter as UncertainParameter,
    UncertainPlant as UncertainPlant,
)
