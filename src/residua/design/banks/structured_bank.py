"""A bank for any attainable structure."""

from __future__ import annotations

from residua.analysis.coding import choose
from residua.analysis.coding_sets import CodingSet, Structure
from residua.design.banks.bank import Bank, build_bank, wanted_rows
from residua.design.banks.member_design import decoupled_member
from residua.design.core.method import FAULTS_APART, Chosen, method
from residua.plant import Plant


def _chosen_rows(plant: Plant, seconds: float) -> CodingSet:
    return choose(plant, time_limit=seconds)


#: A good choice of who fires when what fails.
ROWS = Chosen(_chosen_rows, "rs.coding.choose(plant)", "rs.coding.choose(plant, time_limit={seconds:g})")


@method(
    needs=[FAULTS_APART],
    exists_when="every row attainable: rank conditions of diagnosability",
    order="least for each member",
    source="Gertler (1991), section 4",
    faults="by code, as the structure says",
    decouples=True,
    singular=True,
    many=True,
    chosen={"structure": ROWS},
)
def structured_bank(
    plant: Plant,
    structure: Structure,
    *,
    margin: float | None = None,
    allow_missing: bool = False,
) -> Bank:
    r"""Design one residual per row of an incidence matrix: it answers to the ones and ignores the zeros.

    Each row is a :func:`decoupled_residual` that ignores its zeros and all disturbances. Since every residual that
    ignores them is a filtered version of that one, a row that fails here is attainable by no method.

    Parameters
    ----------
    plant : Plant
        Continuous or sampled, ``E`` singular or not.
    structure : array_like of bool, shape (residuals, faults), or sequence of str, or mapping, or CodingSet
        Columns in the order of ``plant.faults``; rows may be written ``"0111"``. A mapping gives for each residual
        name the faults that it answers to.
    margin : float, optional
        Stability margin of every member in 1/s.
    allow_missing : bool
        Whether rows that are not attainable are left out, and listed in ``failures``, instead of raised.

    Returns
    -------
    Bank

    Raises
    ------
    DesignError
        If a row is not attainable: with the faults that a residual which ignores its zeros cannot see.

    See Also
    --------
    structured_parity : The same with parity relations.
    sensor_fault_bank : One observer per sensor.
    decoupled_residual : One member.
    detection_filter : One filter that names by direction.

    References
    ----------
    Gertler (1991), section 4; Massoumnia, Verghese and Willsky (1989), IEEE TAC 34(3).

    Examples
    --------
    >>> import residua as rs
    >>> plant = rs.library.gertler()
    >>> print(rs.design.structured_bank(plant, ["01", "10"]))
    structured bank, 2 members
         1  2
    r1   .  x
    r2   x  .
      1: p1
      2: p2
    """
    return build_bank(
        plant,
        wanted_rows(structure, plant.faults),
        decoupled_member(plant, margin=margin),
        "structured bank",
        allow_missing=allow_missing,
        reference="Gertler (1991), section 4",
    )
