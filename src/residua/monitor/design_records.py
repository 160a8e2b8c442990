"""Plants and designs as records for JSON, complete to the last bit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.arrays import frozen
from residua.design import Evidence, Member, Observer, ResidualGenerator
from residua.design.core.decoupling import IGNORED, reached
from residua.errors import FileFormatError
from residua.linear import RankDecision, StateSpace
from residua.number_kinds import ANY as REPORT, COMPLEX, ENTRY, NOT_NEGATIVE, STEP
from residua.plant import Fault, Identification, OperatingPoint, Plant
from residua.records import (
    array_in,
    array_out,
    flag_in,
    float_in,
    float_out,
    joined,
    list_in,
    record,
    table_in,
    text_in,
    texts_in,
    whole_in,
)
from residua.tolerances import LEAK

_SYSTEM_ENTRIES = ("A", "B", "C", "D", "dt", "inputs", "outputs", "states")
_PLANT_ARRAYS = ("A", "B", "C", "D", "Bd", "Dd", "Bf", "Df", "Bw", "Dw")
_PLANT_TEXTS = ("name", "description")
_PLANT_NAMES = ("inputs", "outputs", "states", "disturbances")
_PLANT_ENTRIES = (*_PLANT_ARRAYS, "E", "dt", *_PLANT_TEXTS, *_PLANT_NAMES, "faults", "operating_point", "units")
_POLES = ("poles", "requested_poles", "fixed_poles")
_EVIDENCE_ENTRIES = ("method", *_POLES, "decoupling", "conditions", "ranks", "notes", "references")
_OBSERVER_ARRAYS = ("F", "T", "K", "M", "H", "W")
_OBSERVER_OPTIONS = ("J", "V")
_MAPS = ("state_map", "static_map")
_SAMPLED_ENTRIES = ("system", "plant", "evidence", "subspaces", *_MAPS, "known_form", "steady")
_GENERATOR_ENTRIES = (*_SAMPLED_ENTRIES, "method", "members", "observer", "codes", "estimated")


def generator_out(generator: ResidualGenerator) -> dict[str, Any]:
    """Return a generator as a record."""
    observer = generator.observer
    return sampled_out(generator) | {
        "method": generator.method,
        "codes": None if generator.codes is None else [[bool(x) for x in row] for row in generator.codes],
        "estimated": list(generator.estimated),
        "members": [[m.name, list(m.residuals), list(m.faults)] for m in generator.members],
        "observer": None
        if observer is None
        else {
            **{name: array_out(getattr(observer, name)) for name in _OBSERVER_ARRAYS},
            **{name: _array_or_none(getattr(observer, name)) for name in _OBSERVER_OPTIONS},
            "plant": _plant_out(observer.plant),
            "method": observer.method,
            "decouples": bool(observer.decouples),
            "evidence": _evidence_out(observer.evidence),
        },
    }


def generator_in(value: Any, where: str) -> ResidualGenerator:
    """Return the generator that a record describes."""
    content = record(value, where, _GENERATOR_ENTRIES)
    members = [list_in(member, joined(where, "members"), 3) for member in list_in(content["members"], where)]
    return _checked(
        ResidualGenerator(
            **_sampled_fields(content, where),
            method=text_in(content["method"], joined(where, "method")),
            codes=_codes_in(content["codes"], joined(where, "codes")),
            estimated=texts_in(content["estimated"], joined(where, "estimated")),
            observer=None
            if content["observer"] is None
            else _observer_in(content["observer"], joined(where, "observer")),
            members=tuple(
                Member(
                    text_in(name, joined(where, "members")),
                    tuple(whole_in(row, joined(where, "members")) for row in list_in(rows, joined(where, "members"))),
                    texts_in(faults, joined(where, "members")),
                )
                for name, rows, faults in members
            ),
        ),
        where,
    )


def sampled_out(generator: ResidualGenerator) -> dict[str, Any]:
    """Return the parts of a generator that depend on sampling, as a record."""
    return {
        "system": _system_out(generator.system),
        "plant": _plant_out(generator.plant),
        "evidence": _evidence_out(generator.evidence),
        "subspaces": {name: array_out(basis) for name, basis in generator.subspaces.items()},
        **{name: _array_or_none(getattr(generator, name)) for name in _MAPS},
        "known_form": None if generator.known_form is None else _system_out(generator.known_form),
        "steady": None
        if generator.steady is None
        else {name: array_out(vector) for name, vector in generator.steady.items()},
    }


def sampled_in(design: ResidualGenerator, value: Any, where: str) -> ResidualGenerator:
    """Return the sampled generator of a continuous design."""
    fields = _sampled_fields(record(value, where, _SAMPLED_ENTRIES), where)
    return _checked(replace(design, **fields), where)


def _sampled_fields(content: Mapping[str, Any], where: str) -> dict[str, Any]:
    subspaces, known = joined(where, "subspaces"), content["known_form"]
    return {
        "system": _system_in(content["system"], joined(where, "system")),
        "plant": _plant_in(content["plant"], joined(where, "plant")),
        "evidence": _evidence_in(content["evidence"], joined(where, "evidence")),
        "subspaces": _arrays_in(content["subspaces"], subspaces),
        "steady": None if content["steady"] is None else _arrays_in(content["steady"], joined(where, "steady")),
        "known_form": None if known is None else _system_in(known, joined(where, "known_form")),
        **{name: _array_or_none_in(content[name], joined(where, name)) for name in _MAPS},
    }


def _array_or_none(M: NDArray | None) -> Any:
    return None if M is None else array_out(M)


def _array_or_none_in(value: Any, where: str) -> NDArray | None:
    return None if value is None else array_in(value, where, ENTRY, 2)


def _codes_in(value: Any, where: str) -> NDArray[np.bool_] | None:
    """Return the codes of a bank."""
    if value is None:
        return None
    rows = [[flag_in(x, where) for x in list_in(row, where)] for row in list_in(value, where)]
    if len({len(row) for row in rows}) > 1:
        raise FileFormatError(f"{where}: every row must be of the same length")
    return np.array(rows, dtype=bool)


def _arrays_in(value: Any, where: str) -> dict[str, NDArray[np.float64]]:
    return {name: array_in(entry, joined(where, name), ENTRY) for name, entry in table_in(value, where).items()}


def _checked(generator: ResidualGenerator, where: str) -> ResidualGenerator:
    """Return the generator if its parts fit together."""
    system, plant, k = generator.system, generator.plant, generator.n_residuals
    if system.n_inputs != len(plant.inputs) + plant.n_outputs:
        raise FileFormatError(f"{where}: the filter and the plant have different channels")
    if tuple(generator.subspaces) != plant.faults:
        raise FileFormatError(f"{where}: subspaces must be those of the faults of the plant")
    if any(basis.ndim != 2 or len(basis) != k for basis in generator.subspaces.values()):
        raise FileFormatError(f"{where}: every subspace needs {k} rows, one per residual")
    if any(row >= k for member in generator.members for row in member.residuals):
        raise FileFormatError(f"{where}: a member has residuals that are not there")
    if generator.steady is not None and any(
        vector.shape != (k,) or not np.isfinite(vector).all() for vector in generator.steady.values()
    ):
        raise FileFormatError(f"{where}: every steady response needs {k} finite entries")
    if generator.steady is not None:
        record(generator.steady, joined(where, "steady"), plant.faults)
    if not system.is_stable():
        raise FileFormatError(f"{where}: the filter is not stable")
    _check_leaks(generator, where)
    for name, rows in zip(_MAPS, (system.n_states, k), strict=True):
        M = getattr(generator, name)
        if M is not None and M.shape != (rows, plant.n_states):
            raise FileFormatError(f"{where}: {name} must be {rows} x {plant.n_states}")
    if generator.codes is not None and generator.codes.shape != (len(generator.members), len(plant.faults)):
        raise FileFormatError(f"{where}: codes must have a row per member and a column per fault")
    if generator.estimated and len(generator.estimated) != k:
        raise FileFormatError(f"{where}: an estimator names one fault per residual")
    if set(generator.estimated) - {"", *plant.faults}:
        raise FileFormatError(f"{where}: a fault is estimated that the plant does not have")
    form = generator.known_form
    if form is not None and (form.n_outputs != k or form.n_inputs < len(plant.faults)):
        raise FileFormatError(f"{where}: known_form does not fit the filter")
    return generator


def _check_leaks(generator: ResidualGenerator, where: str) -> None:
    """Recompute the leakage of decoupled signals into the residual, since alarms rest on it.

    Of what :func:`make_generator` checks, this and the stability are checked again. The subspaces tell what faults do;
    they are as good as the checksum of the file.
    """
    promised = dict(generator.evidence.decoupling)
    promised.setdefault("disturbance", promised.get(IGNORED, np.inf))
    cost = generator.evidence.cost_of_sampling
    system, plant = generator.system, generator.plant
    gains = reached(system, plant, generator.state_map, generator.static_map)
    for name, gain in gains.items():
        known = max(promised.get(name, np.inf), cost.get(name, 0.0))
        if not gain <= max(2 * LEAK, 1.01 * known):  # twice, for other rounding than where it was made
            raise FileFormatError(
                f"{where}: the {name} inputs reach the residual, by {gain:.2g} of the terms that should cancel"
            )


def _system_out(system: StateSpace) -> dict[str, Any]:
    out: dict[str, Any] = {name: array_out(getattr(system, name)) for name in "ABCD"}
    names = {name: list(getattr(system, name)) for name in ("inputs", "outputs", "states")}
    return out | {"dt": float_out(system.dt)} | names


def _system_in(value: Any, where: str) -> StateSpace:
    content = record(value, where, _SYSTEM_ENTRIES)
    matrices = [array_in(content[name], joined(where, name), ENTRY, 2) for name in "ABCD"]
    names = {name: texts_in(content[name], joined(where, name)) for name in ("inputs", "outputs", "states")}
    return StateSpace(*matrices, dt=float_in(content["dt"], joined(where, "dt"), STEP), **names)


def _plant_out(plant: Plant) -> dict[str, Any]:
    point = plant.operating_point
    return {
        **{name: array_out(getattr(plant, name)) for name in _PLANT_ARRAYS},
        **{name: getattr(plant, name) for name in _PLANT_TEXTS},
        **{name: list(getattr(plant, name)) for name in _PLANT_NAMES},
        "E": None if plant.E is None else array_out(plant.E),
        "dt": float_out(plant.dt),
        "faults": [_fault_out(fault) for fault in plant.fault_list],
        "operating_point": [list(map(float_out, point.inputs)), list(map(float_out, point.outputs))],
        "units": dict(plant.units),
        **_identification_out(plant.identification),
    }


def _identification_out(made: Identification | None) -> dict[str, Any]:
    """Return a record of an identification; nothing for a given plant, so that its file stays unchanged."""
    if made is None:
        return {}
    gains = [list(pair) for pair in made.uncertain_gains]
    return {"identification": [made.method, made.rows, list(made.coloured), list(made.weak_inputs), gains]}


def _identification_in(value: Any, where: str) -> Identification:
    method, rows, coloured, weak, gains = list_in(value, where, 5)
    pairs = [texts_in(list_in(pair, where, 2), where) for pair in list_in(gains, where)]
    uncertain = tuple((output, given) for output, given in pairs)
    return Identification(
        text_in(method, where), whole_in(rows, where), texts_in(coloured, where), texts_in(weak, where), uncertain
    )


def _fault_out(fault: Fault) -> list[str]:
    """Return name, kind and component, and the notes if there are any, so that other files stay unchanged."""
    notes = [fault.description, fault.check, fault.unit]
    return [fault.name, fault.kind, fault.component, *(notes if any(notes) else [])]


def _fault_in(value: Any, where: str) -> Fault:
    """Return a fault from name, kind and component, with or without the three notes."""
    noted = isinstance(value, list) and len(value) == 6
    return Fault(*texts_in(list_in(value, where, 6 if noted else 3), where))


def _plant_in(value: Any, where: str) -> Plant:
    identified = isinstance(value, Mapping) and "identification" in value
    content = record(value, where, (*_PLANT_ENTRIES, *(["identification"] if identified else [])))
    a = {name: array_in(content[name], joined(where, name), ENTRY, 2) for name in _PLANT_ARRAYS}
    names = {name: texts_in(content[name], joined(where, name)) for name in _PLANT_NAMES}
    at, units = joined(where, "operating_point"), joined(where, "units")
    point = [
        tuple(float_in(x, at, ENTRY) for x in list_in(part, at)) for part in list_in(content["operating_point"], at, 2)
    ]
    plant = Plant(
        a["A"],
        a["B"],
        a["C"],
        a["D"],
        E=_array_or_none_in(content["E"], joined(where, "E")),
        dt=float_in(content["dt"], joined(where, "dt"), STEP),
        inputs=names["inputs"],
        outputs=names["outputs"],
        states=names["states"],
        operating_point=OperatingPoint(*point),
        units={key: text_in(unit, joined(units, key)) for key, unit in table_in(content["units"], units).items()},
        identification=_identification_in(content["identification"], joined(where, "identification"))
        if identified
        else None,
        **{name: text_in(content[name], joined(where, name)) for name in _PLANT_TEXTS},
    )
    at = joined(where, "faults")
    faults = tuple(_fault_in(entry, at) for entry in list_in(content["faults"], at))
    columns = {"d": len(names["disturbances"]), "f": len(faults), "w": a["Bw"].shape[1]}
    for letter, count in columns.items():
        if a["B" + letter].shape != (plant.n_states, count) or a["D" + letter].shape != (plant.n_outputs, count):
            raise FileFormatError(f"{where}: B{letter} and D{letter} must have {count} columns and fit the plant")
    return plant._with(
        **{name: frozen(a[name]) for name in _PLANT_ARRAYS[4:]}, disturbances=names["disturbances"], fault_list=faults
    )


def _observer_in(value: Any, where: str) -> Observer:
    content = record(value, where, (*_OBSERVER_ARRAYS, *_OBSERVER_OPTIONS, "plant", "method", "decouples", "evidence"))
    arrays: dict[str, Any] = {name: array_in(content[name], joined(where, name), ENTRY, 2) for name in _OBSERVER_ARRAYS}
    for name in _OBSERVER_OPTIONS:
        arrays[name] = _array_or_none_in(content[name], joined(where, name))
    return Observer(
        plant=_plant_in(content["plant"], joined(where, "plant")),
        method=text_in(content["method"], joined(where, "method")),
        decouples=flag_in(content["decouples"], joined(where, "decouples")),
        evidence=_evidence_in(content["evidence"], joined(where, "evidence")),
        **arrays,
    )


def _evidence_out(evidence: Evidence) -> dict[str, Any]:
    return {
        "method": evidence.method,
        **{name: array_out(getattr(evidence, name)) for name in _POLES},
        **{
            name: {key: float_out(number) for key, number in getattr(evidence, name).items()}
            for name in ("decoupling", "conditions")
        },
        "ranks": {
            name: [int(d.rank), array_out(np.asarray(d.singular_values)), float_out(d.tolerance)]
            for name, d in evidence.ranks.items()
        },
        "notes": list(evidence.notes),
        "references": list(evidence.references),
    }


def _rank_in(value: Any, where: str) -> RankDecision:
    """Return a rank decision, which counts no more singular values than there are."""
    rank, values, tolerance = list_in(value, where, 3)
    sizes, least = array_in(values, where, NOT_NEGATIVE, 1), float_in(tolerance, where, NOT_NEGATIVE)
    made = RankDecision(whole_in(rank, where), sizes, least)
    if not 0 <= made.rank <= len(sizes):
        raise FileFormatError(f"{where}: a rank of {made.rank} does not fit {len(sizes)} singular values")
    return made


def _evidence_in(value: Any, where: str) -> Evidence:
    content = record(value, where, _EVIDENCE_ENTRIES)

    def numbers(name: str) -> dict[str, float]:
        at = joined(where, name)
        return {key: float_in(number, joined(at, key), REPORT) for key, number in table_in(content[name], at).items()}

    ranks = {}
    for name, entry in table_in(content["ranks"], joined(where, "ranks")).items():
        at = joined(joined(where, "ranks"), name)
        ranks[name] = _rank_in(entry, at)
    return Evidence(
        method=text_in(content["method"], joined(where, "method")),
        **{name: array_in(content[name], joined(where, name), COMPLEX, 1) for name in _POLES},
        decoupling=numbers("decoupling"),
        conditions=numbers("conditions"),
        ranks=ranks,
        notes=texts_in(content["notes"], joined(where, "notes")),
        references=texts_in(content["references"], joined(where, "references")),
    )
