"""Linear systems as values, and the matrix and pencil algorithms that SciPy lacks."""

from typing import TYPE_CHECKING

from residua.facade import hand_on

if TYPE_CHECKING:
    from residua.linear.norms.peak_norm import PeakNorm, peak_input, peak_norm
    from residua.linear.norms.system_norms import PeakGain, h2_norm, hinf_norm
    from residua.linear.poles.placement import Placement, default_margin, place_observer_margin, place_observer_poles
    from residua.linear.poles.riccati import RiccatiSolution, filter_riccati
    from residua.linear.poles.stability import is_stable_mode
    from residua.linear.poles.zeros import InvariantZeros, invariant_zeros, normal_rank, pencil_rank_at
    from residua.linear.polynomials.common_factor import PrimitivePart, primitive_part
    from residua.linear.polynomials.polynomial_matrix import PolynomialMatrix
    from residua.linear.polynomials.polynomial_null_space import (
        NullVectors,
        left_null_vectors,
        shortest_left_null_vectors,
    )
    from residua.linear.subspaces.detection_space import DetectionSpace, detection_space
    from residua.linear.subspaces.observability import (
        Detectability,
        ObservabilityForm,
        detectability,
        observability_form,
    )
    from residua.linear.subspaces.rank import DEFAULT_RTOL, RankDecision, decide_rank
    from residua.linear.systems.descriptor import WeierstrassForm, is_regular, weierstrass_form
    from residua.linear.systems.descriptor_properties import (
        DescriptorProperty,
        descriptor_controllability,
        descriptor_observability,
    )
    from residua.linear.systems.descriptor_simulation import (
        ConsistentState,
        DescriptorRun,
        consistent_state,
        simulate_descriptor,
    )
    from residua.linear.systems.sampling import sample
    from residua.linear.systems.state_space import StateSpace
    from residua.robust.bounds.robust_peak_norm import RobustPeakNorm, robust_peak_norm
    from residua.robust.bounds.smallest_gain import SmallestGain, smallest_gain
    from residua.robust.sets.uncertain_system import UncertainSystem

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

hand_on(
    __name__,
    {
        "residua.linear.norms.peak_norm": ("PeakNorm", "peak_input", "peak_norm"),
        "residua.linear.norms.system_norms": ("PeakGain", "h2_norm", "hinf_norm"),
        "residua.linear.poles.placement": (
            "Placement",
            "default_margin",
            "place_observer_margin",
            "place_observer_poles",
        ),
        "residua.linear.poles.riccati": ("RiccatiSolution", "filter_riccati"),
        "residua.linear.poles.stability": ("is_stable_mode",),
        "residua.linear.poles.zeros": ("InvariantZeros", "invariant_zeros", "normal_rank", "pencil_rank_at"),
        "residua.linear.polynomials.common_factor": ("PrimitivePart", "primitive_part"),
        "residua.linear.polynomials.polynomial_matrix": ("PolynomialMatrix",),
        "residua.linear.polynomials.polynomial_null_space": (
            "NullVectors",
            "left_null_vectors",
            "shortest_left_null_vectors",
        ),
        "residua.linear.subspaces.detection_space": ("DetectionSpace", "detection_space"),
        "residua.linear.subspaces.observability": (
            "Detectability",
            "ObservabilityForm",
            "detectability",
            "observability_form",
        ),
        "residua.linear.subspaces.rank": ("DEFAULT_RTOL", "RankDecision", "decide_rank"),
        "residua.linear.systems.descriptor": ("WeierstrassForm", "is_regular", "weierstrass_form"),
        "residua.linear.systems.descriptor_properties": (
            "DescriptorProperty",
            "descriptor_controllability",
            "descriptor_observability",
        ),
        "residua.linear.systems.descriptor_simulation": (
            "ConsistentState",
            "DescriptorRun",
            "consistent_state",
            "simulate_descriptor",
        ),
        "residua.linear.systems.sampling": ("sample",),
        "residua.linear.systems.state_space": ("StateSpace",),
        "residua.robust.bounds.robust_peak_norm": ("RobustPeakNorm", "robust_peak_norm"),
        "residua.robust.bounds.smallest_gain": ("SmallestGain", "smallest_gain"),
        "residua.robust.sets.uncertain_system": ("UncertainSystem",),
    },
)
