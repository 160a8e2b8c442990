"""Plants and residual generators from recordings: one method, one file."""

from residua.identify.grey_box import GreyBox, grey_box
from residua.identify.identified_model import IdentifiedModel, Prediction
from residua.identify.linearise import TangentModel, linearise, tangent_model
from residua.identify.model_report import IdentificationReport
from residua.identify.nonlinear_model import NonlinearModel
from residua.identify.subspace import subspace

__all__ = [
    "GreyBox",
    "IdentificationReport",
    "IdentifiedModel",
    "NonlinearModel",
    "Prediction",
    "TangentModel",
    "grey_box",
    "linearise",
    "subspace",
    "tangent_model",
]
