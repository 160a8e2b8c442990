"""Description of a Functional Mock-up Unit: ``modelDescription.xml``, and a page of its variables."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from residua.export.fmu_variables import FMUVariable, names_in_unit
from residua.export.monitor_program import MonitorProgram

_TYPES = {"2.0": {"real": "Real", "flag": "Boolean", "count": "Integer"},
          "3.0": {"real": "Float64", "flag": "Boolean", "count": "Int32"}}  # fmt: skip
_TOOL = "residua"


def fmi2_description(
    made: MonitorProgram, variables: Sequence[FMUVariable], name: str, token: str, sources: Sequence[str]
) -> str:
    """Return ``modelDescription.xml`` of FMI 2.0, in which time is not a variable.

    Parameters
    ----------
    made : MonitorProgram
    variables : sequence of FMUVariable
        In the order of their references.
    name, token : str
        The model's identifier, and the token that the code checks when it is instantiated.
    sources : sequence of str
        The files to compile.
    """
    root = _root(made, fmiVersion="2.0", guid=token)
    unit = SubElement(
        root, "CoSimulation", modelIdentifier=name, canHandleVariableCommunicationStepSize="true",
        canNotUseMemoryManagementFunctions="true", canGetAndSetFMUstate="true", canSerializeFMUstate="true",
    )  # fmt: skip
    files = SubElement(unit, "SourceFiles")
    for one in sources:
        SubElement(files, "File", name=one)
    _common(root, made, variables)
    listed = SubElement(root, "ModelVariables")
    shown = [(k, one) for k, one in enumerate(variables) if one.role != "independent"]
    for k, one in shown:
        about = _about(one, k)
        start = about.pop("start", None)
        held = SubElement(listed, "ScalarVariable", about)
        value = SubElement(held, _TYPES["2.0"][one.kind], {} if start is None else {"start": start})
        if one.unit:
            value.set("unit", one.unit)
    structure = SubElement(root, "ModelStructure")
    outputs = [place for place, (_, one) in enumerate(shown, 1) if one.role == "output"]
    for group in ("Outputs", "InitialUnknowns"):
        unknowns = SubElement(structure, group)
        for place in outputs:
            SubElement(unknowns, "Unknown", index=str(place), dependencies="")
    return _text(root)


def fmi3_description(made: MonitorProgram, variables: Sequence[FMUVariable], name: str, token: str) -> str:
    """Return ``modelDescription.xml`` of FMI 3.0; parameters as of :func:`fmi2_description`."""
    root = _root(made, fmiVersion="3.0", instantiationToken=token)
    SubElement(
        root, "CoSimulation", modelIdentifier=name, canHandleVariableCommunicationStepSize="true",
        canGetAndSetFMUState="true", canSerializeFMUState="true",
    )  # fmt: skip
    _common(root, made, variables)
    listed = SubElement(root, "ModelVariables")
    for k, one in enumerate(variables):
        held = SubElement(listed, _TYPES["3.0"][one.kind], _about(one, k))
        if one.unit:
            held.set("unit", one.unit)
    structure = SubElement(root, "ModelStructure")
    for group in ("Output", "InitialUnknown"):
        for k, one in enumerate(variables):
            if one.role == "output":
                SubElement(structure, group, valueReference=str(k), dependencies="")
    return _text(root)


def build_description(name: str, sources: Sequence[str], options: str) -> str:
    """Return ``buildDescription.xml`` of FMI 3.0: the compilation of the sources."""
    root = Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = SubElement(root, "BuildConfiguration", modelIdentifier=name)
    files = SubElement(configuration, "SourceFileSet", language="C99", compilerOptions=options)
    for one in sources:
        SubElement(files, "SourceFile", name=one)
    return _text(root)


def _root(made: MonitorProgram, **more: str) -> Element:
    title = names_in_unit([made.name or "plant"], set())[0]
    words = f"Monitor of {title}: a residual, a test of it, and the faults that explain it, {made.dt:g} s apart"
    return Element(
        "fmiModelDescription", more, modelName=f"monitor of {title}", description=words, generationTool=_TOOL,
        variableNamingConvention="flat",
    )  # fmt: skip


def _common(root: Element, made: MonitorProgram, variables: Sequence[FMUVariable]) -> None:
    """Add units, categories of messages, and the step."""
    units = sorted({one.unit for one in variables if one.unit and one.role != "independent"} | {"s"})
    listed = SubElement(root, "UnitDefinitions")
    for unit in units:
        held = SubElement(listed, "Unit", name=unit)
        if unit == "s":
            SubElement(held, "BaseUnit", s="1")
    categories = SubElement(root, "LogCategories")
    SubElement(categories, "Category", name="logStatusError", description="What is wrong")
    SubElement(root, "DefaultExperiment", startTime="0", stepSize=repr(made.dt))


def _about(one: FMUVariable, reference: int) -> dict[str, str]:
    """Return the attributes common to both versions."""
    about = {"name": one.name, "valueReference": str(reference), "description": one.words}
    if one.role == "independent":
        return about | {"causality": "independent", "variability": "continuous"}
    variability = {"input": "discrete", "output": "discrete", "parameter": "fixed", "local": "constant"}[one.role]
    about |= {"causality": one.role, "variability": variability}
    if one.role != "input":
        about["initial"] = "calculated" if one.role == "output" else "exact"
    if one.start is not None:
        about["start"] = repr(one.start) if one.kind == "real" else str(bool(one.start)).lower()
    return about


def _text(root: Element) -> str:
    ElementTree.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'


def documentation(made: MonitorProgram, variables: Sequence[FMUVariable], notes: Sequence[str]) -> str:
    """Return the unit's page: its variables, changed names, and the timing of outputs."""
    rows = [
        (str(k), one.name, one.original if one.original not in ("", one.name) else "", one.role, one.unit, one.words)
        for k, one in enumerate(variables)
    ]
    head = ("reference", "name", "name in the plant, where it is another", "role", "unit", "what it is")
    cells = [f"<tr>{''.join(f'<th>{one}</th>' for one in head)}</tr>"]
    cells += [f"<tr>{''.join(f'<td>{escape(_shown(one))}</td>' for one in row)}</tr>" for row in rows]
    title = escape(_shown(f"Monitor of {made.name or 'a plant'}"))
    words = [
        f"Exported by residua. A sample is taken at the start time and every {made.dt:g} s from there on: at the "
        "beginning of the communication step that starts there. After that step the outputs are those of this sample; "
        "they do not depend on inputs that are set later. A value that is missing is NaN, or outside of its plausible "
        "range.",
        "A communication step may be as long as the time between samples, or a whole part of it. A longer one, or one "
        "with a sample inside of it, is refused, unless hold_inputs is set before initialisation.",
        *notes,
        "It comes without a certificate: what runs in a safety function has to be assessed there.",
    ]
    lines = [f"<p>{escape(_shown(one))}</p>" for one in words]
    return "\n".join(
        [
            "<!DOCTYPE html>",
            f'<html lang="en"><head><meta charset="utf-8"><title>{title}</title></head><body>',
            f"<h1>{title}</h1>",
            *lines,
            "<table>",
            *cells,
            "</table>",
            "</body></html>",
            "",
        ]
    )


def _shown(text: str) -> str:
    return "".join(one if one.isprintable() else "\N{REPLACEMENT CHARACTER}" for one in text)


__all__ = ["build_description", "documentation", "fmi2_description", "fmi3_description"]
