from residua.linear.norms.peak_norm import PeakNorm as PeakNorm, peak_input as peak_input, peak_norm as peak_norm
from residua.linear.norms.system_norms import PeakGain as PeakGain, h2_norm as h2_norm, hinf_norm as hinf_norm
from residua.linear.poles.placement import (
    Placement as Placement,
    default_margin as default_margin,
    place_observer_margin as place_observer_margin,
    place_observer_poles as place_observer_poles,
)
from residua.linear.poles.riccati import RiccatiSolution as RiccatiSolution, filter_riccati as filter_riccati
from residua.linear.poles.stability import is_stable_mode as is_stable_mode
from residua.linear.poles.zeros import (
    InvariantZeros as InvariantZeros,
    invariant_zeros as invariant_zeros,
    normal_rank as normal_rank,
    pencil_rank_at as pencil_rank_at,
)
from residua.linear.polynomials.common_factor import PrimitivePart as PrimitivePart, primitive_part as primitive_part
from residua.linear.polynomials.polynomial_matrix import PolynomialMatrix as PolynomialMatrix
from residua.linear.polynomials.polynomial_null_space import (
    NullVectors as NullVectors,
    left_null_vectors as left_null_vectors,
    shortest_left_null_vectors as shortest_left_null_vectors,
)
from residua.linear.subspaces.detection_space import (
    DetectionSpace as DetectionSpace,
    detection_space as detection_space,
)
from residua.linear.subspaces.observability import (
    Detectability as Detectability,
    ObservabilityForm as ObservabilityForm,
    detectability as detectability,
    observability_form as observability_form,
)
from residua.linear.subspaces.rank import (
    DEFAULT_RTOL as DEFAULT_RTOL,
    RankDecision as RankDecision,
    decide_rank as decide_rank,
)
from residua.linear.systems.descriptor import (
    WeierstrassForm as WeierstrassForm,
    is_regular as is_regular,
    weierstrass_form as weierstrass_form,
)
from residua.linear.systems.descriptor_properties import (
    DescriptorProperty as DescriptorProperty,
    descriptor_controllability as descriptor_controllability,
    descriptor_observability as descriptor_observability,
)
from residua.linear.systems.descriptor_simulation import (
    ConsistentState as ConsistentState,
    DescriptorRun as DescriptorRun,
    consistent_state as consistent_state,
    simulate_descriptor as simulate_descriptor,
)
from residua.linear.systems.sampling import sample as sample
from residua.linear.systems.state_space import StateSpace as StateSpace
from residua.robust.bounds.robust_peak_norm import (
    RobustPeakNorm as RobustPeakNorm,
    robust_peak_norm as robust_peak_norm,
)
from residua.robust.bounds.smallest_gain import SmallestGain as SmallestGain, smallest_gain as smallest_gain
from residua.robust.sets.uncertain_system import UncertainSystem as UncertainSystem
