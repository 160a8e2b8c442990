"""Plants and residual generators from recordings: one method, one file."""

from residua.identify.grey_box import GreyBox, grey_box
from residua.identify.linearise import TangentModel, linearise, tangent_model

__all__ = ["GreyBox", "TangentModel", "grey_box", "linearise", "tangent_model"]
