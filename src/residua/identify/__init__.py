"""Plants and residual generators from recordings: one method, one file."""

from residua.identify.residuals_of_others import given_residuals

__all__ = ["given_residuals"]
