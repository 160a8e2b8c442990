"""Structured residuals from parity relations: one relation per row, the shortest there is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress

import numpy as np

from residua.analysis.coding_sets import Structure
from residua.design.banks.bank import Bank, build_bank, wanted_rows
from residua.design.banks.structured_bank import ROWS
from residua.design.core.generator import ResidualGenerator
from residua.design.core.method import FAULTS_APART, method
from residua.design.parity.relation_model import relation_model
from residua.design.parity.relations import Poles, check_pole_names, relations_of
from residua.design.parity.shortest import shortest_space, with_rank
from residua.errors import AccuracyError, DesignError
from residua.linear.polynomials.pair_relations import PairRelations
from residua.plant import Plant
from residua.plant.input_output_model import InputOutputModel
from residua.tolerances import BALANCED_ANSWER, BALANCED_RANK, NEAR
from residua.words import used_up


@method(
    needs=[FAULTS_APART],
    exists_when="as structured_bank",
    order="of each relation, at most n",
    source="Gertler (1991), section 4.1, eqs. (4-1) to (4-4)",
    faults="by code, as the structure says",
    decouples=True,
    singular=True,
    noise="moving average",
    many=True,
    chosen={"structure": ROWS},
)
def structured_parity(
    plant: Plant | InputOutputModel,
    structure: Structure,
    *,
    poles: Poles | None = None,
    allow_missing: bool = False,
) -> Bank:
    r"""Design one scalar parity relation per row of an incidence matrix, each of the smallest order there is.

    A row is a polynomial vector that annihilates what the row ignores and all disturbances,

    .. math:: w_i^T(z)\, g_j(z) = 0, \qquad w_i^T(z)\, h_j(z) = 0,

    and answers to every one of its ones. Ranks of the balanced plant say which degrees there are, and the singular
    values of a window, in a basis on the poles of the plant, give the vectors. The shortest relation has no factor
    common to all signals; factors that the equations of an input-output model share are divided out, and a note says
    so.

    Parameters
    ----------
    plant : Plant or InputOutputModel
        Continuous or sampled; ``E`` may be singular.
    structure : array_like of bool, shape (residuals, faults), or sequence of str, or mapping
        As for :func:`structured_bank`.
    poles : sequence of complex, or mapping of str to sequence, optional
        For all rows, which must then be of one order, or by name of the row.
    allow_missing : bool
        Whether rows that are not attainable are left out, and listed in ``failures``, instead of raised.

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

    See Also
    --------
    structured_bank : The same with filters, which noise harms less.
    parity_relations : All relations of an order.
    directional_parity : Names by direction.

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
    if isinstance(poles, Mapping):
        names = [one.name for one in wanted]
        check_pole_names(poles, names, names, "row")

    def design(name: str, part: Plant) -> ResidualGenerator:  # its faults are those that the row answers to
        ignored = tuple(fault for fault in model.plant.faults if fault not in part.faults)
        ones, equations = [model.plant.faults.index(fault) for fault in part.faults], model.equations(ignored)
        what = ", ".join(f"'{fault}'" for fault in (*model.plant.disturbances, *ignored)) or "nothing"
        if equations.orders is None:
            raise DesignError(
                f"no parity relation ignores {what}: the {used_up(model.plant.n_outputs)}; add a sensor or ignore less"
            )
        drive = np.linalg.norm(equations.quotient.drive(*model.balanced.faults), axis=0)[ones]
        blind = [fault for fault, size in zip(part.faults, drive, strict=True) if not size > BALANCED_ANSWER]
        if blind:
            raise DesignError(
                f"a parity relation that ignores {what} cannot see {', '.join(blind)}: of up to order "
                f"{equations.orders[1]}, there is none that answers"
            )
        if equations.near:  # where a rank is hardly decided, shorter relations may hold to working precision
            near = model.equations(ignored, tolerance=NEAR * BALANCED_RANK)
            if near.orders is not None and near.orders[1] < equations.orders[1]:
                with suppress(AccuracyError):
                    return relation_of(near, equations, name, ones, part.faults)
        return relation_of(equations, equations, name, ones, part.faults)

    def relation_of(
        used: PairRelations, exact: PairRelations, name: str, ones: list[int], faults: Sequence[str]
    ) -> ResidualGenerator:
        space = shortest_space(model, used, seen=ones)
        relations = relations_of(model.plant, [space.best(ones)], [name])
        row_poles = poles[name] if isinstance(poles, Mapping) else poles
        generator = relations.with_poles(row_poles, method="structured parity relation", notes=model.notes)
        blind = [fault for i, fault in zip(ones, faults, strict=True) if not generator.structure[0, i]]
        if blind:
            raise AccuracyError(
                f"a relation of order {relations.orders[0]} answers to {', '.join(blind)}, but as a filter with "
                "these poles its response is lost in the rounding of its terms: choose poles near those of the "
                "plant, or use structured_bank"
            )
        return with_rank(generator, space, exact.near)

    return build_bank(
        model.plant,
        wanted,
        design,
        "structured parity relations",
        allow_missing=allow_missing,
        reference="Gertler (1991), section 4.1",
    )
