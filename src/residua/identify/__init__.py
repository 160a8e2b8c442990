"""Plants and residual generators from recordings: one method, one file."""

from typing import TYPE_CHECKING

from residua.facade import hand_on

if TYPE_CHECKING:
    from residua.identify.arx import ArxModel, Equation, EquationReport, arx
    from residua.identify.canonical_variates import CanonicalVariates, canonical_variates
    from residua.identify.drifts import Drifts, drifting_channels
    from residua.identify.fit_report import IdentificationReport
    from residua.identify.grey_box import GreyBox, grey_box
    from residua.identify.identified_model import IdentifiedModel, Prediction
    from residua.identify.linearise import TangentModel, linearise, tangent_model
    from residua.identify.parity_from_data import DataParity, parity_from_data
    from residua.identify.prediction_errors import NonlinearModel
    from residua.identify.principal_components import PrincipalComponents, principal_components
    from residua.identify.regimes import OperatingMode, Regimes, regimes
    from residua.identify.regression import Regression, regression
    from residua.identify.residuals_of_others import given_residuals
    from residua.identify.subspace import subspace

__all__ = [
    "ArxModel",
    "CanonicalVariates",
    "DataParity",
    "Drifts",
    "Equation",
    "EquationReport",
    "GreyBox",
    "IdentificationReport",
    "IdentifiedModel",
    "NonlinearModel",
    "OperatingMode",
    "Prediction",
    "PrincipalComponents",
    "Regimes",
    "Regression",
    "TangentModel",
    "arx",
    "canonical_variates",
    "drifting_channels",
    "given_residuals",
    "grey_box",
    "linearise",
    "parity_from_data",
    "principal_components",
    "regimes",
    "regression",
    "subspace",
    "tangent_model",
]

hand_on(
    __name__,
    {
        "residua.identify.arx": ("ArxModel", "Equation", "EquationReport", "arx"),
        "residua.identify.canonical_variates": ("CanonicalVariates", "canonical_variates"),
        "residua.identify.drifts": ("Drifts", "drifting_channels"),
        "residua.identify.fit_report": ("IdentificationReport",),
        "residua.identify.grey_box": ("GreyBox", "grey_box"),
        "residua.identify.identified_model": ("IdentifiedModel", "Prediction"),
        "residua.identify.linearise": ("TangentModel", "linearise", "tangent_model"),
        "residua.identify.prediction_errors": ("NonlinearModel",),
        "residua.identify.parity_from_data": ("DataParity", "parity_from_data"),
        "residua.identify.principal_components": ("PrincipalComponents", "principal_components"),
        "residua.identify.regimes": ("OperatingMode", "Regimes", "regimes"),
        "residua.identify.regression": ("Regression", "regression"),
        "residua.identify.residuals_of_others": ("given_residuals",),
        "residua.identify.subspace": ("subspace",),
    },
)
