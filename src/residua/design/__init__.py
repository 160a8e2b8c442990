"""Residual generators and observers: one method, one file."""

from residua.design.actuator_fault_bank import actuator_fault_bank
from residua.design.bank import Bank
from residua.design.decoupled_residual import decoupled_residual
from residua.design.descriptor_observer import descriptor_observer
from residua.design.detection_filter import detection_filter
from residua.design.evidence import Evidence
from residua.design.generator import Member, ResidualGenerator
from residua.design.kalman_filter import kalman_filter
from residua.design.luenberger_observer import luenberger_observer
from residua.design.observer import Observer
from residua.design.reduced_order_observer import reduced_order_observer
from residua.design.robust_detection_filter import robust_detection_filter
from residua.design.sensor_fault_bank import sensor_fault_bank
from residua.design.structured_bank import structured_bank
from residua.design.unknown_input_observer import unknown_input_observer

__all__ = [
    "Bank",
    "Evidence",
    "Member",
    "Observer",
    "ResidualGenerator",
    "actuator_fault_bank",
    "decoupled_residual",
    "descriptor_observer",
    "detection_filter",
    "kalman_filter",
    "luenberger_observer",
    "reduced_order_observer",
    "robust_detection_filter",
    "sensor_fault_bank",
    "structured_bank",
    "unknown_input_observer",
]
