"""Primary residuals: one equation of the model per output."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from residua.design.core.decoupling import Decoupled
from residua.design.core.evidence import Evidence, format_pole
from residua.design.core.generator import ResidualGenerator, make_generator
from residua.design.core.method import method
from residua.design.core.signals import signal_names
from residua.design.parity.relation import Relation
from residua.design.parity.relation_model import RelationModel, relation_model
from residua.design.parity.relations import Poles, relations_of
from residua.design.parity.shortest import relation_space
from residua.errors import DesignError
from residua.linear import StateSpace, is_stable_mode
from residua.linear.polynomials.polynomial_basis import PolynomialBasis
from residua.plant import Plant
from residua.plant.input_output_model import InputOutputModel


@method(
    exists_when="always; form='arma': a stable plant",
    order="sum of the orders of the equations",
    source="Gertler (1991), eqs. (3-1), (3-2)",
    singular=True,
    noise="moving average",
    many=True,
)
def primary_residuals(
    model: InputOutputModel | Plant, *, form: str = "ma", poles: Poles | None = None
) -> ResidualGenerator:
    r"""Return the residuals that the equations of a model are, one per output.

    .. math:: e^* = H(z)\, y - G(z)\, u = H \Delta y - G \Delta u, \qquad e = y - S(z)\, u = \Delta y - S \Delta u

    the moving-average form ``e*`` and the form ``e`` with the poles of the plant. With ``H`` diagonal each reads one
    output only. All other residuals are transformations of them. Disturbances are not decoupled.

    Parameters
    ----------
    model : InputOutputModel or Plant
        Of a plant each equation is the shortest that reads one output only, as in :meth:`InputOutputModel.from_plant`.
    form : {"ma", "arma"}
    poles : sequence of complex, or mapping of str to sequence, optional
        For the moving-average form; see :meth:`ParityRelations.with_poles`.

    Returns
    -------
    ResidualGenerator
        With residuals ``e1``, ``e2``, ... in the order of the outputs.

    Raises
    ------
    DesignError
        If ``form`` is neither, or ``"arma"`` is asked for an unstable plant, or with poles.

    See Also
    --------
    parity_relations : Ignore chosen faults and all disturbances.
    insensitive_parity : Ignore errors of parameters.
    structured_parity : One relation per row of a structure.

    Notes
    -----
    Assumes: the model is exact, linear and time-invariant, and for ``"arma"`` stable.

    References
    ----------
    Gertler (1991), eqs. (3-1), (3-2).

    Examples
    --------
    >>> import residua as rs
    >>> print(rs.design.primary_residuals(rs.library.gertler()).relations)
    e1 = y1[k] - 0.9 y1[k-1] + 0.2 y1[k-2] - 1.5 u1[k-1] + 0.65 u1[k-2]
    e2 = y2[k] - 1.4 y2[k-1] + 0.45 y2[k-2] - 1.1 u1[k-1] + 0.95 u1[k-2]
    """
    if form not in ("ma", "arma"):
        raise DesignError(f"form must be 'ma' or 'arma', got {form!r}")
    equations = relation_model(model)
    plant = equations.plant
    names = [f"e{i + 1}" for i in range(plant.n_outputs)]
    if form == "arma":
        if poles is not None:
            raise DesignError("the poles of the 'arma' form are those of the plant: leave them out, or use form='ma'")
        return _with_the_poles_of(plant, names)
    rows = _own_equations(model, equations) if isinstance(model, InputOutputModel) else _shortest_of_each(equations)
    return relations_of(plant, rows, names).with_poles(poles, method="primary residuals", notes=equations.notes)


def _own_equations(io: InputOutputModel, equations: RelationModel) -> list[Relation]:
    """Return the equations of a model as relations of its state-space form."""
    every, units = replace(equations, decouples=False).equations(), equations.balanced.units
    rows = []
    for i, k in enumerate(io.H.row_degrees):
        powers = units.rate ** (np.arange(k + 1.0)[:, None] - k)
        q, basis = powers * io.H.coefficients[: k + 1, i] / units.outputs, PolynomialBasis.powers(k + 1)
        q = np.hstack([q, np.zeros((k + 1, len(equations.balanced.algebra)))])
        rows.append(Relation(every, every.completed(q, basis)[0], q, basis))
    return rows


def _shortest_of_each(equations: RelationModel) -> list[Relation]:
    """Return for each output of a plant the shortest relation that reads no other."""
    rows, open_to_all = [], replace(equations, decouples=False)
    for name in equations.plant.outputs:
        alone = open_to_all.reading([name]).equations()
        if alone.orders is None:
            raise DesignError(f"no relation reads {name!r} alone: algebraic equations tie it to other signals")
        rows.append(relation_space(alone, alone.orders[0], equations.balanced.faults).relations[0])
    return rows


def _with_the_poles_of(plant: Plant, names: list[str]) -> ResidualGenerator:
    """Return ``e = y - S u``: the plant runs along as a model."""
    poles = plant.system(()).poles()
    unstable = poles[~is_stable_mode(poles, plant.dt)]
    if len(unstable):
        raise DesignError(
            f"the plant has the pole {format_pole(unstable[0])}, which is not stable, and e = y - S u takes it over: "
            "use form='ma'"
        )
    plant = plant.explicit()
    n, m = plant.n_states, plant.n_outputs
    system = StateSpace(
        plant.A,
        np.hstack([plant.B, np.zeros((n, m))]),
        -plant.C,
        np.hstack([-plant.D, np.eye(m)]),
        dt=plant.dt,
        inputs=signal_names(plant),
        outputs=names,
    )
    evidence = Evidence(
        method="primary residuals",
        poles=system.poles(),
        notes=("the poles are those of the plant",),
        references=("Gertler (1991), eq. (3-1)",),
    )
    decouples = Decoupled(disturbances=False)
    return make_generator(system, plant, "primary residuals", evidence, decouples=decouples, state_map=np.eye(n))
