"""A bank that names the fault and an estimator of its size, as one filter."""

from __future__ import annotations

import numpy as np

from residua.design import ResidualGenerator
from residua.design.banks.bank import maps_of
from residua.design.core.decoupling import Approximate, Decoupled, Promise, reached
from residua.design.core.evidence import of_sampling
from residua.design.core.generator import make_generator
from residua.errors import ModelError
from residua.linear import StateSpace
from residua.linear.systems.state_space import stack_systems
from residua.plant.channels import ROLES

_ALIKE = ("inputs", "outputs", "faults", "disturbances", "dt")
_EQUAL = ("A", "E", "C", *(matrix + role for role in ROLES.values() for matrix in "BD"))


def with_estimator(bank: ResidualGenerator, estimator: ResidualGenerator) -> ResidualGenerator:
    """Return a bank with the estimates of a fault estimator as further outputs, not tested by any member.

    Parameters
    ----------
    bank, estimator : ResidualGenerator
        Both for the same plant: ``codes`` of the one, ``estimated`` of the other.

    Raises
    ------
    ModelError
        If the first is not a bank, the second not an estimator, or their plants differ.
    """
    if bank.codes is None:
        raise ModelError("an estimator runs beside a bank, whose members are tested one by one; this is not a bank")
    if not estimator.estimated:
        raise ModelError("estimator= must be a fault estimator: this generator estimates no fault")
    one, other = bank.plant, estimator.plant
    differ = [name for name in _ALIKE if getattr(one, name) != getattr(other, name)]
    differ += [name for name in _EQUAL if not np.array_equal(getattr(one, name), getattr(other, name))]
    if differ:
        raise ModelError(
            f"bank and estimator are for different plants ({', '.join(differ)}): design both for bank.plant"
        )
    system = stack_systems([bank.system, estimator.system])
    names = [*bank.residuals, *estimator.residuals]
    promise, cost = _promise(bank, estimator, system)
    return make_generator(
        system.replaced(outputs=names),
        one,
        f"{bank.method}, with {estimator.method}",
        bank.evidence.extended(decoupling=cost, notes=(f"beside it, tested by no member: {estimator.method}",)),
        decouples=promise,
        **maps_of([bank, estimator], names),
        members=bank.members,
        codes=bank.codes,
        estimated=("",) * bank.n_residuals + estimator.estimated,
    )


def _promise(
    bank: ResidualGenerator, estimator: ResidualGenerator, system: StateSpace
) -> tuple[Promise, dict[str, float]]:
    """Return the common promise of both, and the cost of sampling, which bounds the promise of sampled designs."""
    if bank.state_map is not None and estimator.state_map is not None:
        return Decoupled(disturbances="disturbance" in bank.evidence.decoupling), {}
    cost = of_sampling(reached(system, bank.plant, None))
    return Approximate(next(iter(cost), "")), cost
