from residua.identify.arx import (
    ArxModel as ArxModel,
    Equation as Equation,
    EquationReport as EquationReport,
    arx as arx,
)
from residua.identify.canonical_variates import (
    CanonicalVariates as CanonicalVariates,
    canonical_variates as canonical_variates,
)
from residua.identify.drifts import Drifts as Drifts, drifting_channels as drifting_channels
from residua.identify.fit_report import IdentificationReport as IdentificationReport
from residua.identify.grey_box import GreyBox as GreyBox, grey_box as grey_box
from residua.identify.identified_model import IdentifiedModel as IdentifiedModel, Prediction as Prediction
from residua.identify.linearise import (
    TangentModel as TangentModel,
    linearise as linearise,
    tangent_model as tangent_model,
)
from residua.identify.parity_from_data import DataParity as DataParity, parity_from_data as parity_from_data
from residua.identify.prediction_errors import NonlinearModel as NonlinearModel
from residua.identify.principal_components import (
    PrincipalComponents as PrincipalComponents,
    principal_components as principal_components,
)
from residua.identify.regimes import OperatingMode as OperatingMode, Regimes as Regimes, regimes as regimes
from residua.identify.regression import Regression as Regression, regression as regression
from residua.identify.residuals_of_others import given_residuals as given_residuals
from residua.identify.subspace import subspace as subspace
