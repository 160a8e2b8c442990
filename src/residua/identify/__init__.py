"""Plants and residual generators from recordings: one method, one file."""

from residua.identify.grey_box import GreyBox, grey_box
from residua.identify.linearise import TangentModel, linearise, tangent_model
from residua.identify.nonlinear_model import NonlinearModel

__all__ = ["GreyBox", "NonlinearModel", "TangentModel", "grey_box", "linearise", "tangent_model"]
