"""Residual generators and observers: one method, one file."""

from residua.design.detection_filter import detection_filter
from residua.design.evidence import Evidence
from residua.design.generator import Member, ResidualGenerator
from residua.design.kalman_filter import kalman_filter
from residua.design.observer import Observer
from residua.design.robust_detection_filter import robust_detection_filter
from residua.design.unknown_input_observer import unknown_input_observer

__all__ = [
    "Evidence",
    "Member",
    "Observer",
    "ResidualGenerator",
    "detection_filter",
    "kalman_filter",
    "robust_detection_filter",
    "unknown_input_observer",
]
