"""What can be asked of an input-output model: its polynomials, names, transfer functions and text."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.errors import ModelError
from residua.linear.polynomials.polynomial_matrix import PolynomialMatrix
from residua.plant.channels import ROLES, Fault, OperatingPoint
from residua.plant.fault_facts import FaultFacts
from residua.plant.polynomial_text import equation_text


@dataclass(frozen=True, init=False, eq=False, repr=False)
class InputOutputFacts(FaultFacts):
    """The fields of :class:`InputOutputModel`, and what follows from them."""

    H: PolynomialMatrix
    G: PolynomialMatrix
    Gd: PolynomialMatrix
    Gf: PolynomialMatrix
    dt: float
    variable: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    measured_inputs: tuple[str, ...]
    disturbances: tuple[str, ...]
    fault_list: tuple[Fault, ...]
    name: str
    operating_point: OperatingPoint
    units: Mapping[str, str]
    description: str
    delays: tuple[int, ...]

    @property
    def n_outputs(self) -> int:
        """Number of outputs, and of equations."""
        return self.H.shape[0]

    @property
    def is_discrete(self) -> bool:
        """Whether the model is sampled."""
        return self.dt > 0

    @property
    def is_diagonal(self) -> bool:
        """Whether every equation has one output."""
        off = self.H.coefficients[:, ~np.eye(self.n_outputs, dtype=bool)]
        return not np.any(off)

    def right_side(self, roles: Iterable[str] = ("control", "disturbance", "fault")) -> PolynomialMatrix:
        """Return the columns of ``G``, ``Gd`` and ``Gf`` of the given roles, in that order."""
        parts = {"control": self.G, "disturbance": self.Gd, "fault": self.Gf}
        chosen = [roles] if isinstance(roles, str) else list(roles)
        for role in chosen:
            if role not in parts:
                hint = " (an input-output model has no noise)" if role in ROLES else ""
                raise ModelError(f"unknown role {role!r}{hint}; known: {', '.join(parts)}")
        return PolynomialMatrix(np.zeros((1, self.n_outputs, 0))).beside(*(parts[role] for role in chosen))

    def transfer(
        self, points: ArrayLike, roles: Iterable[str] = ("control", "disturbance", "fault")
    ) -> NDArray[np.complex128]:
        r"""Return the transfer matrix :math:`S = H^{-1} [G\ G_d\ G_f]` at values of ``z`` or ``s``.

        Parameters
        ----------
        points : array_like of complex, shape (k,)
        roles : sequence of str
            Whose columns, in that order.

        Returns
        -------
        ndarray of complex, shape (k, outputs, inputs of these roles)
        """
        at = np.atleast_1d(np.asarray(points, dtype=complex))
        H, N = self.H.evaluate(at), self.right_side(roles).evaluate(at)
        size = np.abs(H).max(axis=2, keepdims=True, initial=0.0)
        size = np.where(size > 0, size, 1.0)
        try:
            return np.asarray(np.linalg.solve(H / size, N / size), dtype=complex)
        except np.linalg.LinAlgError as error:
            raise ModelError(f"the model has a pole at one of the points asked for: {error}") from error

    def __str__(self) -> str:
        letter = "z" if self.is_discrete else "s"
        names = (*self.inputs, *self.disturbances, *self.faults)
        right = self.right_side().coefficients
        return "\n".join(
            equation_text(
                [(self.H.coefficients[:, i, j], name) for j, name in enumerate(self.outputs)],
                [(right[:, i, j], name) for j, name in enumerate(names)],
                letter,
            )
            for i in range(self.n_outputs)
        )

    def __repr__(self) -> str:
        kind = f"dt={self.dt:g} s" if self.is_discrete else "continuous"
        return (
            f"InputOutputModel({self.name!r}: degrees {', '.join(map(str, self.H.row_degrees))}, {len(self.inputs)} "
            f"inputs, {self.n_outputs} outputs, {len(self.disturbances)} disturbances, {len(self.fault_list)} faults, "
            f"{kind})"
        )
