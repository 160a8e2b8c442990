"""Residual generators and observers: one method, one file."""

from typing import TYPE_CHECKING

from residua.facade import hand_on

if TYPE_CHECKING:
    from residua.design import catalogue
    from residua.design.banks.actuator_fault_bank import actuator_fault_bank
    from residua.design.banks.bank import Bank
    from residua.design.banks.decoupled_residual import decoupled_residual
    from residua.design.banks.matched_filters import MatchedFilters, matched_filters
    from residua.design.banks.sensor_fault_bank import sensor_fault_bank
    from residua.design.banks.structured_bank import structured_bank
    from residua.design.core.evidence import Evidence
    from residua.design.core.generator import Member, ResidualGenerator
    from residua.design.core.method import Method, method
    from residua.design.detection_filters.detection_filter import detection_filter, robust_detection_filter
    from residua.design.detection_filters.eigenstructure_assignment import eigenstructure_assignment
    from residua.design.estimation.accommodation import Compensation, closed_loop, compensation_gain
    from residua.design.estimation.fault_estimator import FaultEstimator, fault_estimator
    from residua.design.estimation.sensor_fault_estimators import SensorFaultEstimators, sensor_fault_estimators
    from residua.design.observers.general_residual_generator import (
        GeneralForm,
        general_form,
        residual_generator_from_observer,
    )
    from residua.design.observers.inverse_form_observer import InverseFormObserver, inverse_form_observer
    from residua.design.observers.kalman_filter import kalman_filter
    from residua.design.observers.luenberger_observer import luenberger_observer
    from residua.design.observers.observer import Observer
    from residua.design.observers.perfect_observer import PerfectObserver, perfect_observer
    from residua.design.observers.reduced_order_observer import descriptor_observer, reduced_order_observer
    from residua.design.observers.unknown_input_observer import unknown_input_observer
    from residua.design.parity.directional_parity import directional_parity
    from residua.design.parity.equivalence import Equivalence, RowTransformation
    from residua.design.parity.parity_relations import chow_willsky_matrices, parity_orders, parity_relations
    from residua.design.parity.primary_residuals import primary_residuals
    from residua.design.parity.relations import ParityRelations
    from residua.design.parity.structured_parity import structured_parity
    from residua.design.suggestion import Suggestion
    from residua.robust.estimators.certified_threshold import CertifiedThreshold, certified_thresholds
    from residua.robust.estimators.genetic_search import GeneticSearch
    from residua.robust.estimators.global_search import DifferentialEvolution, SearchResult
    from residua.robust.estimators.robust_estimator import RobustEstimator
    from residua.robust.estimators.robust_l1_bank import RobustL1Bank, robust_l1_bank
    from residua.robust.parity.insensitive_parity import InsensitiveParity, insensitive_parity
    from residua.robust.parity.multi_model_parity import MultiModelParity, model_spread, multi_model_parity
    from residua.robust.parity.optimal_parity import OptimalParity, optimal_parity
    from residua.robust.parity.select_equations import EquationChoice, select_equations

__all__ = [
    "Bank",
    "CertifiedThreshold",
    "Compensation",
    "DifferentialEvolution",
    "EquationChoice",
    "Equivalence",
    "Evidence",
    "FaultEstimator",
    "GeneralForm",
    "GeneticSearch",
    "InsensitiveParity",
    "InverseFormObserver",
    "MatchedFilters",
    "Member",
    "Method",
    "MultiModelParity",
    "Observer",
    "OptimalParity",
    "ParityRelations",
    "PerfectObserver",
    "ResidualGenerator",
    "RobustEstimator",
    "RobustL1Bank",
    "RowTransformation",
    "SearchResult",
    "SensorFaultEstimators",
    "Suggestion",
    "actuator_fault_bank",
    "catalogue",
    "certified_thresholds",
    "chow_willsky_matrices",
    "closed_loop",
    "compensation_gain",
    "decoupled_residual",
    "descriptor_observer",
    "detection_filter",
    "directional_parity",
    "eigenstructure_assignment",
    "fault_estimator",
    "general_form",
    "insensitive_parity",
    "inverse_form_observer",
    "kalman_filter",
    "luenberger_observer",
    "matched_filters",
    "method",
    "model_spread",
    "multi_model_parity",
    "optimal_parity",
    "parity_orders",
    "parity_relations",
    "perfect_observer",
    "primary_residuals",
    "reduced_order_observer",
    "residual_generator_from_observer",
    "robust_detection_filter",
    "robust_l1_bank",
    "select_equations",
    "sensor_fault_bank",
    "sensor_fault_estimators",
    "structured_bank",
    "structured_parity",
    "unknown_input_observer",
]

hand_on(
    __name__,
    {
        "residua.design.banks.actuator_fault_bank": ("actuator_fault_bank",),
        "residua.design.banks.bank": ("Bank",),
        "residua.design.banks.decoupled_residual": ("decoupled_residual",),
        "residua.design.banks.matched_filters": ("MatchedFilters", "matched_filters"),
        "residua.design.banks.sensor_fault_bank": ("sensor_fault_bank",),
        "residua.design.banks.structured_bank": ("structured_bank",),
        "residua.design.core.evidence": ("Evidence",),
        "residua.design.core.generator": ("Member", "ResidualGenerator"),
        "residua.design.core.method": ("Method", "method"),
        "residua.design.detection_filters.detection_filter": ("detection_filter", "robust_detection_filter"),
        "residua.design.detection_filters.eigenstructure_assignment": ("eigenstructure_assignment",),
        "residua.design.estimation.accommodation": ("Compensation", "closed_loop", "compensation_gain"),
        "residua.design.estimation.fault_estimator": ("FaultEstimator", "fault_estimator"),
        "residua.design.estimation.sensor_fault_estimators": ("SensorFaultEstimators", "sensor_fault_estimators"),
        "residua.design.observers.general_residual_generator": (
            "GeneralForm",
            "general_form",
            "residual_generator_from_observer",
        ),
        "residua.design.observers.inverse_form_observer": ("InverseFormObserver", "inverse_form_observer"),
        "residua.design.observers.kalman_filter": ("kalman_filter",),
        "residua.design.observers.luenberger_observer": ("luenberger_observer",),
        "residua.design.observers.observer": ("Observer",),
        "residua.design.observers.perfect_observer": ("PerfectObserver", "perfect_observer"),
        "residua.design.observers.reduced_order_observer": ("descriptor_observer", "reduced_order_observer"),
        "residua.design.observers.unknown_input_observer": ("unknown_input_observer",),
        "residua.design.parity.directional_parity": ("directional_parity",),
        "residua.design.parity.equivalence": ("Equivalence", "RowTransformation"),
        "residua.design.parity.parity_relations": ("chow_willsky_matrices", "parity_orders", "parity_relations"),
        "residua.design.parity.primary_residuals": ("primary_residuals",),
        "residua.design.parity.relations": ("ParityRelations",),
        "residua.design.parity.structured_parity": ("structured_parity",),
        "residua.design.suggestion": ("Suggestion",),
        "residua.robust.estimators.certified_threshold": ("CertifiedThreshold", "certified_thresholds"),
        "residua.robust.estimators.genetic_search": ("GeneticSearch",),
        "residua.robust.estimators.global_search": ("DifferentialEvolution", "SearchResult"),
        "residua.robust.estimators.robust_estimator": ("RobustEstimator",),
        "residua.robust.estimators.robust_l1_bank": ("RobustL1Bank", "robust_l1_bank"),
        "residua.robust.parity.insensitive_parity": ("InsensitiveParity", "insensitive_parity"),
        "residua.robust.parity.multi_model_parity": ("MultiModelParity", "model_spread", "multi_model_parity"),
        "residua.robust.parity.optimal_parity": ("OptimalParity", "optimal_parity"),
        "residua.robust.parity.select_equations": ("EquationChoice", "select_equations"),
    },
    ["residua.design.catalogue"],
)
