"""Plants and residual generators from recordings: one method, one file."""

from residua.identify.identified_model import IdentifiedModel
from residua.identify.model_report import IdentificationReport
from residua.identify.subspace import subspace

__all__ = ["IdentificationReport", "IdentifiedModel", "subspace"]
