"""Plants and residual generators from recordings: one method, one file."""

from residua.identify.canonical_variates import CanonicalVariates, canonical_variates
from residua.identify.parity_from_data import DataParity, parity_from_data
from residua.identify.principal_components import PrincipalComponents, principal_components

__all__ = [
    "CanonicalVariates",
    "DataParity",
    "PrincipalComponents",
    "canonical_variates",
    "parity_from_data",
    "principal_components",
]
