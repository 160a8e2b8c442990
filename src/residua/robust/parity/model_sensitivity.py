"""The equations of a plant and how they change with its parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.errors import AccuracyError, DesignError, ModelError, SettingError
from residua.plant import Plant
from residua.plant.input_output_model import InputOutputModel

Model = Callable[..., Plant | InputOutputModel]
#: The step of the differences, as a fraction of the change of the parameter that is expected.
_STEP = 0.05
#: Derivatives by two steps may differ by this fraction of the largest coefficient.
_AGREE = 1e-3
#: An expected change that moves a coefficient by less than this, for the largest of its signal, moves it by rounding.
_UNMOVED = 1e-9


@dataclass(frozen=True, eq=False)
class Equations:
    r"""Primary residuals :math:`e^* = H y - G u` as weights of the last samples, with their derivatives.

    Attributes
    ----------
    model : InputOutputModel
        The nominal one.
    outputs, inputs : ndarray, shape (equations, order + 1, channels)
        Weights of the samples, the oldest first.
    output_slopes, input_slopes : ndarray, shape (parameters, equations, order + 1, channels)
    """

    model: InputOutputModel
    outputs: NDArray[np.float64]
    inputs: NDArray[np.float64]
    output_slopes: NDArray[np.float64]
    input_slopes: NDArray[np.float64]


def equations_of(model: Model, values: Mapping[str, float], changes: Mapping[str, float]) -> Equations:
    """Return the equations of ``model(**values)`` and their derivatives, by central differences with two steps.

    Raises
    ------
    ModelError
        If the function returns no sampled plant, or one with other signals.
    DesignError
        If a parameter changes nothing, or changes the order of an equation.
    AccuracyError
        If the derivatives by the two steps disagree.
    """
    nominal = _evaluated(model, values)
    order = int(max(nominal.H.row_degrees))
    H, G = _weights(nominal, nominal, order, "the nominal values")
    largest = np.abs(np.concatenate([H, G], axis=2)).max(axis=1, keepdims=True)  # of each signal in each equation
    slopes = []

    def weights_at(name: str, value: float) -> NDArray[np.float64]:
        made = _evaluated(model, {**values, name: value})
        return np.concatenate(_weights(made, nominal, order, f"{name} = {value:.6g}"), axis=2)

    for name, value in values.items():
        steps = _STEP * changes[name], 0.5 * _STEP * changes[name]
        far, near = ((weights_at(name, value + h) - weights_at(name, value - h)) / (2 * h) for h in steps)
        slope = (4 * near - far) / 3  # the terms of second order cancel
        slope = np.where(np.abs(slope) * changes[name] > _UNMOVED * largest, slope, 0.0)
        size = float(np.abs(slope).max())
        if not size:
            raise DesignError(f"parameter {name!r} changes no equation: it cannot be seen, and need not be ignored")
        error = float(np.abs(near - far).max() / size)
        if not error <= _AGREE:
            raise AccuracyError(
                f"derivatives with respect to {name!r} by steps of {_STEP * changes[name]:.2g} and half of it differ "
                f"by {error:.2g} of the largest: the model is not smooth there, or changes={{...}} names too "
                "large a change"
            )
        slopes.append(slope)
    m = len(nominal.outputs)
    whole = np.array(slopes)
    return Equations(nominal, H, G, whole[..., :m], whole[..., m:])


def _evaluated(model: Model, values: Mapping[str, float]) -> InputOutputModel:
    """Return the equations for some values of the parameters."""
    equations = model(**values)
    if isinstance(equations, Plant):
        equations = InputOutputModel.from_plant(equations)
    if not isinstance(equations, InputOutputModel):
        raise ModelError(f"the model must return a Plant or an InputOutputModel, got {type(equations).__name__}")
    if not equations.dt:
        raise ModelError(
            "the model returns a continuous plant; what depends on the data is evaluated sample by sample: let it "
            "return the sampled plant, plant.discretize(dt)"
        )
    return equations


def _weights(
    varied: InputOutputModel, nominal: InputOutputModel, order: int, where: str
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the weights of samples of outputs and inputs, the newest sample of every equation last."""
    for what in ("inputs", "outputs", "dt"):
        if getattr(varied, what) != getattr(nominal, what):
            raise ModelError(f"the model has other {what} with {where}: they must not depend on the parameters")
    degrees = varied.H.row_degrees
    if degrees != nominal.H.row_degrees:
        raise DesignError(
            f"with {where} the equations are of orders {', '.join(map(str, degrees))}, nominally of "
            f"{', '.join(map(str, nominal.H.row_degrees))}: a state gets in or out of view there; choose other nominal "
            "values, or return an InputOutputModel of one structure"
        )
    H, G = varied.H.padded(max(order, varied.H.degree)), varied.G.padded(max(order, varied.H.degree))
    out_H, out_G = (np.zeros((len(degrees), order + 1, M.shape[2])) for M in (H, G))
    for i, k in enumerate(degrees):
        out_H[i, order - k :], out_G[i, order - k :] = H[: k + 1, i], -G[: k + 1, i]
    return out_H, out_G


def checked_parameters(
    parameters: Mapping[str, float], changes: Mapping[str, float] | None
) -> tuple[dict[str, float], dict[str, float]]:
    """Return nominal values and expected changes: a tenth of the value when omitted."""
    if not isinstance(parameters, Mapping) or not parameters:
        raise SettingError("parameters must be a mapping of names to nominal values")
    values = {str(name): float(value) for name, value in parameters.items()}
    unknown = sorted(set(changes or {}) - set(values))
    if unknown:
        raise SettingError(f"there is no parameter {unknown[0]!r}; there are {', '.join(values)}")
    sizes = {name: abs(float((changes or {}).get(name, 0.1 * value))) for name, value in values.items()}
    for name, size in sizes.items():
        if not np.isfinite(values[name]) or not np.isfinite(size) or not size > 0:
            raise SettingError(
                f"parameter {name!r} = {values[name]!r} with an expected change of {size!r}: both must be finite, the "
                "change positive; give it, changes={...}, where the nominal value is zero"
            )
    return values, sizes
