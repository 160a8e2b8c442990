"""Linear regression of recorded outputs on the inputs; its errors are residuals."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.design.core.evidence import Evidence
from residua.design.core.generator import ResidualGenerator
from residua.errors import SettingError
from residua.identify.channel_filter import channel_generator, channels_in, few_rows, lagged_rows, standard, untreated
from residua.identify.segments import Names, checked_count, gather
from residua.linear.subspaces.rank import null_basis, range_basis
from residua.tolerances import DATA_ROUNDING
from residua.visible import listed
from residua.words import counted

_METHOD = "regression on recorded inputs"


@dataclass(frozen=True, eq=False, repr=False)
class Regression:
    """A linear regression of recorded outputs on inputs, with the generator of its errors.

    Attributes
    ----------
    generator : ResidualGenerator
        The filter that a :class:`residua.Monitor` runs.
    lags : int
    coefficients : ndarray, shape (lags + 1, outputs, inputs)
        In the units of the channels; those of the present row first.
    explained : ndarray, shape (outputs,)
        Part of the variance of each output that the inputs explain, on the same rows.
    mean : ndarray, shape (channels,)
        Of each channel: the regression goes through it.
    samples : int
    """

    generator: ResidualGenerator
    lags: int
    coefficients: NDArray[np.float64] = field(repr=False)
    explained: NDArray[np.float64] = field(repr=False)
    mean: NDArray[np.float64] = field(repr=False)
    samples: int

    def __repr__(self) -> str:
        parts = zip(self.generator.residuals, self.explained, strict=True)
        return f"Regression({', '.join(f'{name}: {100 * part:.3g} % explained' for name, part in parts)})"


def regression(
    recordings: Any,
    y: ArrayLike | None = None,
    *,
    inputs: Names = None,
    outputs: Names = None,
    lags: int = 0,
    dt: float | None = None,
) -> Regression:
    r"""Return the errors of a linear regression of recorded outputs on inputs, as a residual generator.

    .. math:: r_k = y_k - \bar y - \sum_{i=0}^{L} \Theta_i\, (u_{k-i} - \bar u), \qquad
              \min_\Theta \sum_k \| r_k \|^2

    one residual for each output, called as the output, in its unit. Without inputs it is the deviation from the mean.
    Columns of the recordings may be computed before: products, differences, anything that physics says the outputs
    depend on.

    Guaranteed: the residual does not correlate with the inputs on the rows that it is from. The same statistic of a
    monitor when a channel has other units, as far as these differ by a power of two.

    Parameters
    ----------
    recordings : Recording, data frame, path, array, pair (u, y), or a list of these
        Fault-free; rows with a missing value cut them into segments.
    y : array_like, shape (time, outputs), optional
    inputs, outputs : sequence of str, optional
        Channels by name; without inputs all columns are outputs.
    lags : int
        ``L``: rows before the present one of which the inputs count too.
    dt : float, optional
        Step in seconds of arrays.

    Returns
    -------
    Regression

    Raises
    ------
    DataError
        If a channel never changes, or there are no more rows than columns ``channels (lags + 1)``.
    SettingError
        If ``lags`` is out of range, or a channel is named twice.

    Notes
    -----
    Assumes: what moves the outputs and is no input is the same in the recordings and later. In a control loop the
    coefficients are those of the loop, not of the plant: of use for what is usual, not for what causes what. Inputs
    that determine one another share their coefficients (the smallest ones), and a note names them.

    References
    ----------
    Draper and Smith (1998), Applied Regression Analysis, 3rd edition, Wiley, chapter 5.

    See Also
    --------
    residua.identify.arx : with the outputs' own past, and a model that any design takes.
    residua.identify.parity_from_data : all linear relations at once.
    residua.identify.regimes : one for each operating mode.

    Examples
    --------
    >>> import numpy as np
    >>> import residua as rs
    >>> rng = np.random.default_rng(0)
    >>> u = rng.standard_normal((500, 2))
    >>> y = u @ [[2.0], [-1.0]] + 5 + 0.1 * rng.standard_normal((500, 1))
    >>> made = rs.identify.regression(u, y, inputs=["valve", "speed"], outputs=["flow"])
    >>> made
    Regression(flow: 99.8 % explained)
    >>> made.coefficients.round(1).tolist()
    [[[2.0, -1.0]]]
    """
    lags = checked_count(lags, "lags")
    gathered = gather(recordings, y, inputs=inputs, outputs=outputs, dt=dt)
    if not gathered.outputs:
        raise SettingError("there is no output to predict: name one, outputs=[...]")
    units = standard(gathered)
    stacked = lagged_rows(gathered, units, lags)
    m, q = len(gathered.inputs), stacked.channels
    known = stacked.columns(range(lags + 1), range(m))
    wanted = stacked.columns(range(1), range(m, q))
    X, Y = stacked.factor[:, known], stacked.factor[:, wanted]
    moved, decision = range_basis(X.T, rtol=DATA_ROUNDING)
    Q, R = np.linalg.qr(X @ moved)
    theta = moved @ np.linalg.solve(R, Q.T @ Y)
    explained = np.maximum(1 - np.sum((Y - X @ theta) ** 2, axis=0) / np.sum(Y**2, axis=0), 0.0)
    size = units.spread[m:]
    weights = np.zeros((lags + 1, q - m, q))
    weights[0, :, m:] = np.diag(size)
    weights[:, :, :m] = -theta.reshape(lags + 1, m, q - m).transpose(0, 2, 1) * size[:, None]
    still, _ = null_basis(X, rtol=DATA_ROUNDING)
    shared = ()
    if still.size:
        names = listed(channels_in(still, gathered.inputs, DATA_ROUNDING))
        shared = (
            f"{counted(still.shape[1], 'combination')} of {names} never moved: they determine one another, and share "
            "their coefficients",
        )
    evidence = Evidence(
        _METHOD,
        ranks={"inputs": decision},
        conditions={"least part explained": float(explained.min())},
        notes=(*few_rows(stacked.count, len(known) + 1), *units.facts.repeated_outputs(), *shared),
        references=("Draper and Smith (1998)",),
    )
    groups = dict.fromkeys(gathered.outputs, 1)
    generator = channel_generator(untreated(gathered, units, units.facts.notes(gathered)), weights, groups, evidence)
    coefficients = -weights[:, :, :m] / units.spread[:m]
    return Regression(generator, lags, coefficients, explained, units.mean, stacked.count)
