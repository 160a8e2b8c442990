"""The command ``analyze``: the faults of a plant that can be detected and isolated."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from residua.analysis import Diagnosability, diagnosability
from residua.cli import screen
from residua.cli.shared_options import AsJson, PlantFile, check_file
from residua.plant.plant_file import load_plant
from residua.words import counted


def analyze(plant: PlantFile, as_json: AsJson = False) -> None:
    """Show which faults of a plant can be detected and isolated.

    For the others it gives the reason. It also checks whether an unknown input observer exists for the disturbances.
    """
    check_file(plant, "plant file")
    answer = diagnosability(load_plant(plant))
    if as_json:
        screen.print_json(diagnosability_values(answer))
    else:
        show_diagnosability(answer)


def show_diagnosability(answer: Diagnosability) -> None:
    """Print which faults of a plant can be detected and isolated, and why the others cannot."""
    plant = answer.plant
    time = f"sampled at {plant.dt:g} s" if plant.is_discrete else "continuous"
    screen.say(
        f"{plant.name}: {counted(plant.n_states, 'state')}, {counted(len(plant.inputs), 'input')}, "
        f"{counted(plant.n_outputs, 'output')}, {counted(len(plant.disturbances), 'disturbance')}, "
        f"{counted(len(plant.faults), 'fault')}, {time}"
    )
    screen.show_table(
        [
            "fault",
            "kind",
            "component",
            "detectable",
            "when constant",
            "cannot be told from",
            "nor, when constant",
        ],
        [
            [
                name,
                plant.fault_kinds[i],
                plant.fault_components[i],
                answer.detectable[i],
                answer.strongly_detectable[i],
                ", ".join(twins(answer.groups, name)),
                ", ".join(answer.constant_twins(name)),
            ]
            for i, name in enumerate(answer.faults)
        ],
    )
    why = [f"{name}: {reason}" for name, reason in answer.reasons().items()]
    screen.say(*(why or ["every fault can be detected, also when constant, and isolated from all others"]))
    if plant.disturbances:
        screen.say(str(answer.unknown_input_observer))
    else:
        screen.say("no disturbances: an ordinary observer is enough")


def twins(groups: Iterable[tuple[str, ...]], name: str) -> list[str]:
    """Return the other faults in the group of a fault."""
    return [other for group in groups if name in group for other in group if other != name]


def diagnosability_values(answer: Diagnosability) -> dict[str, Any]:
    """Return detectability and isolability as plain values for JSON."""
    plant, reasons, existence = answer.plant, answer.reasons(), answer.unknown_input_observer
    return {
        "plant": plant.name,
        "dt": plant.dt,
        "states": list(plant.states),
        "inputs": list(plant.inputs),
        "outputs": list(plant.outputs),
        "disturbances": list(plant.disturbances),
        "faults": [
            {
                "name": name,
                "kind": plant.fault_kinds[i],
                "component": plant.fault_components[i],
                "detectable": bool(answer.detectable[i]),
                "strongly_detectable": bool(answer.strongly_detectable[i]),
                "visibility": float(answer.visibility[i]),
                "not_isolable_from": twins(answer.groups, name),
                "not_isolable_when_constant_from": list(answer.constant_twins(name)),
                "reason": reasons.get(name),
            }
            for i, name in enumerate(answer.faults)
        ],
        "isolable": answer.isolable.tolist(),
        "strongly_isolable": answer.strongly_isolable.tolist(),
        "groups": [list(group) for group in answer.groups],
        "unknown_input_observer": {
            "exists": existence.exists,
            "useful": existence.useful,
            "reasons": list(existence.reasons),
            "rank_CE": existence.rank_CE.rank,
            "rank_E": existence.rank_E.rank,
            "fixed_poles": [[float(p.real), float(p.imag)] for p in existence.fixed_poles],
        },
    }
