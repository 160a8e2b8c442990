"""Structured residuals from parity relations: one relation per row, the shortest there is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from residua.analysis.coding_sets import Structure
from residua.design.banks.bank import Bank, build_bank, wanted_rows
from residua.design.generator import ResidualGenerator
from residua.design.parity.parity_relations import with_rank
from residua.design.parity.relation_model import RelationModel, relation_model
from residua.design.parity.relations import Poles, relations_of
from residua.design.parity.shortest import shortest_relation
from residua.errors import DesignError
from residua.linear.pencil_null_space import DEFAULT_RTOL
from residua.plant import Plant
from residua.plant.input_output_model import InputOutputModel


def structured_parity(
    plant: Plant | InputOutputModel,
    structure: Structure,
    *,
    poles: Poles | None = None,
    allow_missing: bool = False,
    rtol: float = DEFAULT_RTOL,
) -> Bank:
    r"""Design one scalar parity relation per row of an incidence matrix, each of the smallest order there is.

    A row is a polynomial vector that annihilates what the row ignores and all disturbances,

    .. math:: w_i^T(z)\, g_j(z) = 0, \qquad w_i^T(z)\, h_j(z) = 0,

    and answers to every one of its ones. Degrees are found by search, vectors from the singular values of block
    Toeplitz matrices; what the resulting relation has as a factor common to all signals is divided out, and told.

    Parameters
    ----------
    plant : Plant or InputOutputModel
        Continuous or sampled; ``E`` may be singular.
    structure : array_like of bool, shape (residuals, faults), or sequence of str, or mapping
        As for :func:`structured_bank`.
    poles : sequence of complex, or mapping of str to sequence, optional
        For all rows, which must then be of one order, or by name of the row.
    allow_missing : bool
        Whether rows that are not attainable are left out, and told in ``failures``, instead of raised.
    rtol : float
        Relative tolerance of rank decisions, in balanced units.

    Returns
    -------
    Bank
        ``bank.generator.relations`` hold the polynomials.

    Raises
    ------
    DesignError
        If a row is not attainable: with the faults that no relation sees which ignores its zeros.
    AccuracyError
        If a relation is too ill-conditioned: :func:`structured_bank` needs no polynomials.

    Notes
    -----
    Assumes: the model is exact, linear and time-invariant. Each relation is of an order of at most the number of
    states; with ``D = 0`` and ``m - 1`` signals ignored, of which ``s`` are inputs, of ``n - s`` (4-4).

    References
    ----------
    Gertler (1991), eqs. (4-1) to (4-4).

    Examples
    --------
    >>> import residua as rs
    >>> bank = rs.design.structured_parity(rs.library.gertler(), ["01", "10"])
    >>> bank.generator.relations.orders
    (2, 2)
    """
    model = relation_model(plant)
    wanted = wanted_rows(structure, model.plant.faults)
    names = {one.seen: one.name for one in wanted}

    def design(part: Plant) -> ResidualGenerator:  # its faults are those that the row answers to
        ignored = tuple(name for name in model.plant.faults if name not in part.faults)
        return _scalar_relation(model, ignored, part.faults, _of_row(poles, names[part.faults]), rtol)

    return build_bank(
        model.plant,
        wanted,
        design,
        "structured parity relations",
        allow_missing=allow_missing,
        reference="Gertler (1991), section 4.1",
    )


def _scalar_relation(
    model: RelationModel, ignored: Sequence[str], seen: Sequence[str], poles: Poles | None, rtol: float
) -> ResidualGenerator:
    """Return the generator of the shortest relation that ignores and sees what was asked for."""
    vector, space = shortest_relation(model, ignored, seen, rtol)
    relations = relations_of(model.plant, [space.relation(model, ignored, vector)])
    return with_rank(relations.with_poles(poles, method="structured parity relation", notes=model.notes), space)


def _of_row(poles: Poles | None, name: str) -> Poles | None:
    """Return the poles of one row."""
    if not isinstance(poles, Mapping):
        return poles
    if name not in poles:
        raise DesignError(f"there are no poles for row {name!r}")
    return poles[name]
