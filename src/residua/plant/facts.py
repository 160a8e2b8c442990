"""What can be asked of a plant: its matrices, names, covariances, and the system from chosen inputs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.errors import ModelError
from residua.linear import StateSpace
from residua.plant.channels import ROLES, Fault, OperatingPoint, by_role
from residua.plant.fault_facts import FaultFacts


@dataclass(frozen=True, init=False, eq=False, repr=False)
class PlantFacts(FaultFacts):
    """The fields of :class:`residua.Plant`, and what follows from them."""

    A: NDArray[np.float64]
    C: NDArray[np.float64]
    E: NDArray[np.float64] | None
    Bu: NDArray[np.float64]
    Du: NDArray[np.float64]
    Bd: NDArray[np.float64]
    Dd: NDArray[np.float64]
    Bf: NDArray[np.float64]
    Df: NDArray[np.float64]
    Bw: NDArray[np.float64]
    Dw: NDArray[np.float64]
    dt: float
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    states: tuple[str, ...]
    disturbances: tuple[str, ...]
    fault_list: tuple[Fault, ...]
    name: str
    operating_point: OperatingPoint
    units: Mapping[str, str]
    description: str

    @property
    def n_states(self) -> int:
        """Number of states."""
        return self.A.shape[0]

    @property
    def n_outputs(self) -> int:
        """Number of measured outputs."""
        return self.C.shape[0]

    @property
    def is_discrete(self) -> bool:
        """Whether the plant is sampled."""
        return self.dt > 0

    @property
    def noises(self) -> tuple[str, ...]:
        """Names of the noise inputs."""
        return tuple(f"w{i + 1}" for i in range(self.Bw.shape[1]))

    @property
    def process_noise(self) -> NDArray[np.float64]:
        """Covariance of the state noise, ``Bw Bw'``, shape (n, n)."""
        return self.Bw @ self.Bw.T

    @property
    def measurement_noise(self) -> NDArray[np.float64]:
        """Covariance of the measurement noise, ``Dw Dw'``, shape (outputs, outputs)."""
        return self.Dw @ self.Dw.T

    @property
    def cross_noise(self) -> NDArray[np.float64]:
        """Covariance between state and measurement noise, ``Bw Dw'``."""
        return self.Bw @ self.Dw.T

    def system(self, roles: Iterable[str] = ("control", "disturbance", "fault", "noise")) -> StateSpace:
        """Return the plant as a plain system driven by the inputs of the given roles, in that order."""
        chosen = []
        for role in (roles,) if isinstance(roles, str) else tuple(roles):
            if role not in ROLES:
                raise ModelError(f"unknown role {role!r}; known: {', '.join(ROLES)}")
            chosen.append(role)
        channels = {
            "control": self.inputs,
            "disturbance": self.disturbances,
            "fault": self.faults,
            "noise": self.noises,
        }
        letters = [ROLES[role] for role in chosen]
        labels = [name for role in chosen for name in channels[role]]
        empty_B, empty_D = np.zeros((self.n_states, 0)), np.zeros((self.n_outputs, 0))
        return StateSpace(
            self.A,
            np.hstack([empty_B, *(getattr(self, "B" + letter) for letter in letters)]),
            self.C,
            np.hstack([empty_D, *(getattr(self, "D" + letter) for letter in letters)]),
            E=self.E,
            dt=self.dt,
            inputs=labels if len(set(labels)) == len(labels) else by_role(chosen, channels),
            outputs=self.outputs,
            states=self.states,
        )

    def __repr__(self) -> str:
        kind = f"dt={self.dt:g} s" if self.is_discrete else "continuous"
        return (
            f"Plant({self.name!r}: {self.n_states} states, {len(self.inputs)} inputs, "
            f"{self.n_outputs} outputs, "
            f"{len(self.disturbances)} disturbances, {len(self.faults)} faults, {kind})"
        )
