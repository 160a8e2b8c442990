from residua.design import catalogue as catalogue
from residua.design.banks.actuator_fault_bank import actuator_fault_bank as actuator_fault_bank
from residua.design.banks.bank import Bank as Bank
from residua.design.banks.decoupled_residual import decoupled_residual as decoupled_residual
from residua.design.banks.matched_filters import MatchedFilters as MatchedFilters, matched_filters as matched_filters
from residua.design.banks.sensor_fault_bank import sensor_fault_bank as sensor_fault_bank
from residua.design.banks.structured_bank import structured_bank as structured_bank
from residua.design.core.evidence import Evidence as Evidence
from residua.design.core.generator import Member as Member, ResidualGenerator as ResidualGenerator
from residua.design.core.method import Method as Method, method as method
from residua.design.detection_filters.detection_filter import (
    detection_filter as detection_filter,
    robust_detection_filter as robust_detection_filter,
)
from residua.design.detection_filters.eigenstructure_assignment import (
    eigenstructure_assignment as eigenstructure_assignment,
)
from residua.design.estimation.accommodation import (
    Compensation as Compensation,
    closed_loop as closed_loop,
    compensation_gain as compensation_gain,
)
from residua.design.estimation.fault_estimator import (
    FaultEstimator as FaultEstimator,
    fault_estimator as fault_estimator,
)
from residua.design.estimation.sensor_fault_estimators import (
    SensorFaultEstimators as SensorFaultEstimators,
    sensor_fault_estimators as sensor_fault_estimators,
)
from residua.design.observers.general_residual_generator import (
    GeneralForm as GeneralForm,
    general_form as general_form,
    residual_generator_from_observer as residual_generator_from_observer,
)
from residua.design.observers.inverse_form_observer import (
    InverseFormObserver as InverseFormObserver,
    inverse_form_observer as inverse_form_observer,
)
from residua.design.observers.kalman_filter import kalman_filter as kalman_filter
from residua.design.observers.luenberger_observer import luenberger_observer as luenberger_observer
from residua.design.observers.observer import Observer as Observer
from residua.design.observers.perfect_observer import (
    PerfectObserver as PerfectObserver,
    perfect_observer as perfect_observer,
)
from residua.design.observers.reduced_order_observer import (
    descriptor_observer as descriptor_observer,
    reduced_order_observer as reduced_order_observer,
)
from residua.design.observers.unknown_input_observer import unknown_input_observer as unknown_input_observer
from residua.design.parity.directional_parity import directional_parity as directional_parity
from residua.design.parity.equivalence import Equivalence as Equivalence, RowTransformation as RowTransformation
from residua.design.parity.parity_relations import (
    chow_willsky_matrices as chow_willsky_matrices,
    parity_orders as parity_orders,
    parity_relations as parity_relations,
)
from residua.design.parity.primary_residuals import primary_residuals as primary_residuals
from residua.design.parity.relations import ParityRelations as ParityRelations
from residua.design.parity.structured_parity import structured_parity as structured_parity
from residua.design.suggestion import Suggestion as Suggestion
from residua.robust.estimators.certified_threshold import (
    CertifiedThreshold as CertifiedThreshold,
    certified_thresholds as certified_thresholds,
)
from residua.robust.estimators.genetic_search import GeneticSearch as GeneticSearch
from residua.robust.estimators.global_search import (
    DifferentialEvolution as DifferentialEvolution,
    SearchResult as SearchResult,
)
from residua.robust.estimators.robust_estimator import RobustEstimator as RobustEstimator
from residua.robust.estimators.robust_l1_bank import RobustL1Bank as RobustL1Bank, robust_l1_bank as robust_l1_bank
from residua.robust.parity.insensitive_parity import (
    InsensitiveParity as InsensitiveParity,
    insensitive_parity as insensitive_parity,
)
from residua.robust.parity.multi_model_parity import (
    MultiModelParity as MultiModelParity,
    model_spread as model_spread,
    multi_model_parity as multi_model_parity,
)
from residua.robust.parity.optimal_parity import OptimalParity as OptimalParity, optimal_parity as optimal_parity
from residua.robust.parity.select_equations import (
    EquationChoice as EquationChoice,
    select_equations as select_equations,
)
