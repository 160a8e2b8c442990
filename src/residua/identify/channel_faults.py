"""The faults of a plant that was identified from channels alone: one of every sensor, and of every actuator."""

from __future__ import annotations

from residua.plant import Plant


def with_channel_faults(plant: Plant, *, sensors: bool, actuators: bool) -> Plant:
    """Return the plant with a fault of every output, of every input that has an effect, or both."""
    plant = plant.with_sensor_faults() if sensors else plant
    idle = idle_inputs(plant)
    effective = [name for name in plant.inputs if name not in idle]
    return plant.with_actuator_faults(effective) if actuators and effective else plant


def idle_inputs(plant: Plant) -> list[str]:
    """Return the inputs that do nothing in the model."""
    return [name for name, b, d in zip(plant.inputs, plant.B.T, plant.D.T, strict=True) if not (b.any() or d.any())]


__all__ = ["idle_inputs", "with_channel_faults"]
