"""Linear systems as values, and the matrix and pencil algorithms that SciPy lacks."""

from residua.linear.common_factor import PrimitivePart, primitive_part
from residua.linear.descriptor import WeierstrassForm, is_regular, weierstrass_form
from residua.linear.descriptor_properties import (
    DescriptorProperty,
    descriptor_controllability,
    descriptor_observability,
)
from residua.linear.descriptor_simulation import (
    ConsistentState,
    DescriptorRun,
    consistent_state,
    simulate_descriptor,
)
from residua.linear.detection_space import DetectionSpace, detection_space
from residua.linear.norms import PeakGain, h2_norm, hinf_norm
from residua.linear.observability import (
    Detectability,
    ObservabilityForm,
    detectability,
    is_stable_mode,
    observability_form,
)
from residua.linear.peak_norm import PeakNorm, peak_input, peak_norm
from residua.linear.placement import Placement, default_margin, place_observer_margin, place_observer_poles
from residua.linear.polynomial_matrix import PolynomialMatrix
from residua.linear.polynomial_null_space import NullVectors, left_null_vectors, shortest_left_null_vectors
from residua.linear.rank import DEFAULT_RTOL, RankDecision, decide_rank
from residua.linear.riccati import RiccatiSolution, filter_riccati
from residua.linear.robust_norm import RobustPeakNorm, SmallestGain, robust_peak_norm, smallest_gain
from residua.linear.sampling import sample
from residua.linear.state_space import StateSpace
from residua.linear.uncertain_system import UncertainSystem
from residua.linear.zeros import InvariantZeros, invariant_zeros, normal_rank, pencil_rank_at

__all__ = [
    "DEFAULT_RTOL",
    "ConsistentState",
    "DescriptorProperty",
    "DescriptorRun",
    "Detectability",
    "DetectionSpace",
    "InvariantZeros",
    "NullVectors",
    "ObservabilityForm",
    "PeakGain",
    "PeakNorm",
    "Placement",
    "PolynomialMatrix",
    "PrimitivePart",
    "RankDecision",
    "RiccatiSolution",
    "RobustPeakNorm",
    "SmallestGain",
    "StateSpace",
    "UncertainSystem",
    "WeierstrassForm",
    "consistent_state",
    "decide_rank",
    "default_margin",
    "descriptor_controllability",
    "descriptor_observability",
    "detectability",
    "detection_space",
    "filter_riccati",
    "h2_norm",
    "hinf_norm",
    "invariant_zeros",
    "is_regular",
    "is_stable_mode",
    "left_null_vectors",
    "normal_rank",
    "observability_form",
    "peak_input",
    "peak_norm",
    "pencil_rank_at",
    "place_observer_margin",
    "place_observer_poles",
    "primitive_part",
    "robust_peak_norm",
    "sample",
    "shortest_left_null_vectors",
    "simulate_descriptor",
    "smallest_gain",
    "weierstrass_form",
]
