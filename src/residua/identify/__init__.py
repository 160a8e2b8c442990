"""Plants and residual generators from recordings: one method, one file."""

from residua.identify.canonical_variates import CanonicalVariates, canonical_variates
from residua.identify.identified_model import IdentifiedModel
from residua.identify.model_report import IdentificationReport
from residua.identify.parity_from_data import DataParity, parity_from_data
from residua.identify.principal_components import PrincipalComponents, principal_components
from residua.identify.subspace import subspace

__all__ = [
    "CanonicalVariates",
    "DataParity",
    "IdentificationReport",
    "IdentifiedModel",
    "PrincipalComponents",
    "canonical_variates",
    "parity_from_data",
    "principal_components",
    "subspace",
]
