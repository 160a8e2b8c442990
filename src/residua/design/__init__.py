"""Residual generators and observers: one method, one file."""

from residua.design.accommodation import Compensation, closed_loop, compensation_gain
from residua.design.actuator_fault_bank import actuator_fault_bank
from residua.design.bank import Bank
from residua.design.decoupled_residual import decoupled_residual
from residua.design.descriptor_observer import descriptor_observer
from residua.design.detection_filter import detection_filter
from residua.design.evidence import Evidence
from residua.design.fault_estimator import FaultEstimator, fault_estimator
from residua.design.generator import Member, ResidualGenerator
from residua.design.inverse_form_observer import InverseFormObserver, inverse_form_observer
from residua.design.kalman_filter import kalman_filter
from residua.design.luenberger_observer import luenberger_observer
from residua.design.observer import Observer
from residua.design.perfect_observer import PerfectObserver, perfect_observer
from residua.design.reduced_order_observer import reduced_order_observer
from residua.design.robust_detection_filter import robust_detection_filter
from residua.design.sensor_fault_bank import sensor_fault_bank
from residua.design.sensor_fault_estimators import SensorFaultEstimators, sensor_fault_estimators
from residua.design.structured_bank import structured_bank
from residua.design.suggestion import Suggestion
from residua.design.unknown_input_observer import unknown_input_observer

__all__ = [
    "Bank",
    "Compensation",
    "Evidence",
    "FaultEstimator",
    "InverseFormObserver",
    "Member",
    "Observer",
    "PerfectObserver",
    "ResidualGenerator",
    "SensorFaultEstimators",
    "Suggestion",
    "actuator_fault_bank",
    "closed_loop",
    "compensation_gain",
    "decoupled_residual",
    "descriptor_observer",
    "detection_filter",
    "fault_estimator",
    "inverse_form_observer",
    "kalman_filter",
    "luenberger_observer",
    "perfect_observer",
    "reduced_order_observer",
    "robust_detection_filter",
    "sensor_fault_bank",
    "sensor_fault_estimators",
    "structured_bank",
    "unknown_input_observer",
]
