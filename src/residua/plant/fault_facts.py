"""Names, kinds and components of faults, shared by plants and input-output models."""

from __future__ import annotations

from residua.plant.channels import Fault


class FaultFacts:
    """The faults of a model with a ``fault_list``."""

    fault_list: tuple[Fault, ...]

    @property
    def faults(self) -> tuple[str, ...]:
        """Names of the faults, in the order of their columns."""
        return tuple(fault.name for fault in self.fault_list)

    @property
    def fault_kinds(self) -> tuple[str, ...]:
        """``"actuator"``, ``"sensor"`` or ``"component"`` for each fault; sensors of inputs are sensors."""
        return tuple(fault.kind for fault in self.fault_list)

    @property
    def fault_components(self) -> tuple[str, ...]:
        """The component of each fault."""
        return tuple(fault.component for fault in self.fault_list)
