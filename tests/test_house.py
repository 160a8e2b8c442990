"""The rules of the house, read from its syntax tree: where a module stands, what it may import, how long a body is.

A ratchet is a number of places that do not keep a rule yet: it only ever goes down.
"""

from __future__ import annotations

import ast
import re
from collections import Counter, defaultdict
from pathlib import Path

import pytest

from guards import claimed, guards
from house_report import (
    FRAGMENT,
    LARGEST_MODULE,
    SCREEN,
    UNDECIDED,
    methods,
    mixins,
    named_tolerances,
    offered,
    rank_decisions,
    single_importers,
    tolerances,
)
from house_tree import SOURCE, House, Module, body_lines

#: Imports run down this list; the modules of the first line, which lie loose, may import one another.
ROOMS = (
    *(
        "errors",
        "visible",
        "words",
        "tolerances",
        "number_kinds",
        "arrays",
        "kernels",
        "facade",
        "threads",
        "shown",
        "wrong_guesses",
        "progress",
        "files",
        "json_files",
        "records",
    ),
    *("linear", "plant", "recording", "analysis", "design", "decide", "robust", "library", "identify"),
    *("monitor", "validate", "export", "cluster"),
    *("report", "live", "testing", "demos", "cli", "residua", "__main__"),
)
LOOSE = ROOMS[: ROOMS.index("linear")]

#: Who may look up, or across to what stands on it: the facades, whose methods and names live where they are made.
FACADES = {
    "residua.linear": "residua.robust",  # public names of uncertain systems
    "residua.plant": "residua.robust",  # public names of uncertain plants
    "residua.design": "residua.robust",  # public names of robust designs
    "residua.linear.systems.state_space": "residua.linear.systems",  # discretize, simulate
    "residua.plant.plant": "residua.plant",  # from_state_space, from_toml, to_toml, discretize
    "residua.plant.input_output_model": "residua.plant",  # from_plant, from_transfer_functions, to_plant
    "residua.robust.sets.uncertain_plant": "residua.robust.sets",  # from_parameters, in_closed_loop, ...
    "residua.decide": ("residua.monitor", "residua.validate"),  # residual_report, detectability: of whole monitors
    "residua.design.core.generator": "residua.design",  # to_parity, equivalent_to, observer
    "residua.design.suggestion": "residua.robust.sets",  # suggest, for an uncertain plant too
    "residua.monitor.monitor": "residua.monitor",  # save, load
    "residua.monitor.regime_monitor": "residua.monitor",  # save, load
    "residua.monitor.diagnosis": "residua.report",  # plot, to_html
    "residua.validate.campaign_result": "residua.report",  # to_html
    "residua.cli": "residua.cli",  # main, which says what package is missing
    "residua.cli.demo_command": "residua.demos",  # demo
    "residua.cli.live_command": ("residua.live", "residua.demos"),  # live, whose packages are an extra
}
#: Where generators are made: the gate, the same in other units, and designs read from files, checked there.
GATE = ("residua.design.core.generator", "residua.design.core.canonical_design", "residua.monitor.design_records")
#: What of a generator was checked with it.
PROMISED = {"system", "subspaces", "state_map", "static_map", "known_form"}
#: Kinds of files, each of which is a file here too, whoever reads it.
FORMATS = ("residua.recording.mat_files", "residua.recording.npz_files", "residua.recording.parquet_files")

# Ratchets: the number of places, by room where a room is being rebuilt.
IN_CIRCLES: dict[str, int] = {}
FRAGMENTS = {"monitor": 2}
LONG_BODIES: dict[str, int] = {}
LONG_MODULES: dict[str, int] = {}
SPELLED = {"decide": 0, "monitor": 2}  # the columns of data frames
TOLERANCES, DISTINCT_TOLERANCES, NAMES_WITH_SEVERAL_VALUES, WITHOUT_EVIDENCE = 286, 23, 0, 51


@pytest.fixture(scope="module")
def house() -> House:
    return House()


def by_room(modules: list[Module]) -> Counter[str]:
    return Counter(module.room for module in modules)


def over(found: Counter[str], ratchet: dict[str, int]) -> dict[str, int]:
    """Return the rooms with more places than a ratchet allows."""
    return {room: count for room, count in found.items() if count > ratchet.get(room, 0)}


# ------------------------------------------------------------- A: rooms


def test_every_module_is_in_a_room(house: House) -> None:
    assert {module.room for module in house.modules.values()} <= set(ROOMS)


def test_imports_run_down_the_rooms(house: House) -> None:
    height = {room: 0 if room in LOOSE else k for k, room in enumerate(ROOMS)}
    up = []
    for one in house.imports:
        here, there = house.modules[one.importer], house.modules[one.target]
        allowed = FACADES.get(here.name)
        version = here.room == "cli" and there.name == "residua"
        if height[there.room] > height[here.room] and not version and not (allowed and there.name.startswith(allowed)):
            up.append(f"{here.name}:{one.line} imports {there.name}")
    for module in house.modules.values():
        for name in module.texts & (house.modules.keys() - {"residua"}):
            above = height[house.modules[name].room] > height[module.room]
            if above and not name.startswith(FACADES.get(module.name, "nothing")):
                up.append(f"{module.name} hands on names of {name}")
    assert up == []


def test_the_page_about_the_rooms_lists_them_in_this_order() -> None:
    page = (SOURCE.parent / "docs" / "architecture.rst").read_text(encoding="utf-8")
    table = page[page.index("The rooms\n") : page.index("The way of the data\n")]
    rows = [row.split("\n     - ")[0] for row in table.split("\n   * - ")[1:]]
    listed = [name for row in rows for name in re.findall(r"``(\w+)/?``", row)]
    assert listed == [room for room in ROOMS if room not in ("residua", "__main__")]


def test_only_facades_import_inside_functions(house: House) -> None:
    hidden = [one for one in house.imports if one.how == "function"]
    found = [f"{i.importer}:{i.line} imports {i.target}" for i in hidden if not _handed(i.importer, i.target)]
    assert found == []


def test_every_facade_still_looks_up(house: House) -> None:
    used = {i.importer for i in house.imports if _handed(i.importer, i.target)}
    assert sorted(set(FACADES) - used) == []


def _handed(importer: str, target: str) -> bool:
    return importer in FACADES and target.startswith(FACADES[importer])


# ----------------------------------------------------------- B: circles


def test_no_circle_of_imports(house: House) -> None:
    lazy = {(i.importer, i.target) for i in house.imports if i.how != "top" and _handed(i.importer, i.target)}
    circles = house.circles("top", "type", beside=lazy)
    found = by_room([house.modules[name] for circle in circles for name in circle])
    assert over(found, IN_CIRCLES) == {}, circles


# ------------------------------------------------------ C: one idea a file


def test_no_fragment_with_one_importer(house: House) -> None:
    own = set(methods(house))
    kept = [
        (module, user)
        for module, user in single_importers(house, FRAGMENT)
        if module.name.rpartition(".")[2] not in own
        and module.name not in FORMATS
        and not defines_a_kind(module)
        and len(module.text.splitlines()) + len(user.text.splitlines()) <= LARGEST_MODULE
    ]
    found = by_room([module for module, _ in kept])
    assert over(found, FRAGMENTS) == {}, [(a.name, a.code_lines, b.name) for a, b in kept]


def defines_a_kind(module: Module) -> bool:
    """Tell whether a module is a kind of test or of isolation: each has a file of its own."""
    bases = {base.id for one in module.classes for base in one.bases if isinstance(base, ast.Name)}
    return bool(bases & {"TestSettings", "ResidualTest", "IsolationSettings", "Isolation"})


def test_a_kind_in_a_file_of_its_own_is_no_fragment_and_an_option_no_tolerance(tmp_path: Path) -> None:
    text = "class Mine(TestSettings):\n    rate: float = 1e-3\n\n\ndef made(*, level: float = 1e-6):\n    return 1e-9\n"
    module = Module("residua.decide.mine", tmp_path, text)
    assert defines_a_kind(module)
    assert list(tolerances(module)) == [1e-9]


def test_no_mixin_with_one_heir(house: House) -> None:
    assert mixins(house) == []


def test_no_body_of_a_function_is_longer_than_a_screen(house: House) -> None:
    long = [(m, f.name, body_lines(f)) for m in house.modules.values() for f in m.functions if body_lines(f) > SCREEN]
    assert over(by_room([m for m, _, _ in long]), LONG_BODIES) == {}, [(m.name, name, n) for m, name, n in long]


def test_no_module_is_too_long_for_one_idea(house: House) -> None:
    long = [m for m in house.modules.values() if len(m.text.splitlines()) > LARGEST_MODULE]
    assert over(by_room(long), LONG_MODULES) == {}, [m.name for m in long]


# -------------------------------------------------- E: declared protocols


def test_no_attribute_of_a_design_by_its_spelling(house: House) -> None:
    """A monitor asks a design for what a protocol declares: no ``getattr`` by a text, no stand-in for a design."""
    asked = []
    for module in house.modules.values():
        if module.room in SPELLED:
            calls = [n for n in module.nodes if isinstance(n, ast.Call) and isinstance(n.func, ast.Name)]
            for call in calls:
                spelled = call.func.id in ("getattr", "hasattr") and isinstance(call.args[1], ast.Constant)  # pyright: ignore
                if spelled or call.func.id == "SimpleNamespace":  # pyright: ignore
                    asked.append(module)
    assert over(by_room(asked), SPELLED) == {}, [m.name for m in asked]


# ------------------------------------------------------ D: the only gate


def test_no_generator_is_made_beside_the_gate(house: House) -> None:
    """What a residual is, its filter, maps and subspaces, is set where it is checked, or changed in its units alone."""
    made = []
    for module in house.modules.values():
        if module.name not in GATE:
            for call in (n for n in module.nodes if isinstance(n, ast.Call) and isinstance(n.func, ast.Name)):
                words = {word.arg for word in call.keywords}
                changed = call.func.id == "replace" and words & PROMISED  # pyright: ignore
                if call.func.id == "ResidualGenerator" or changed:  # pyright: ignore
                    made.append(f"{module.name}:{call.lineno}")
    assert made == []


# ------------------------------------------------- G: the evidence is tested


def test_every_guard_of_the_evidence_has_a_test_that_trips_it() -> None:
    """The tests that say so are watched while they run (:mod:`guards`)."""
    assert sorted(guards().keys() - claimed().keys()) == []
    assert sorted(claimed().keys() - guards().keys()) == []


# ---------------------------------------------------------- H: tolerances


def test_tolerances_are_few_and_named(house: House) -> None:
    checked = [module for module in house.modules.values() if module.room != "testing"]  # there they stand by the test
    found = [value for module in checked for value in tolerances(module)]
    assert len(found) <= TOLERANCES
    assert len(set(found)) <= DISTINCT_TOLERANCES


def test_one_name_of_a_tolerance_has_one_value(house: House) -> None:
    values: dict[str, set[float]] = defaultdict(set)
    for module in house.modules.values():
        for name, value in named_tolerances(module):
            values[name.lstrip("_")].add(value)
    assert len([name for name, some in values.items() if len(some) > 1]) <= NAMES_WITH_SEVERAL_VALUES, values


def test_ranks_are_decided_with_their_evidence(house: House) -> None:
    found = [name for m in house.modules.values() for name in rank_decisions(m) if name in UNDECIDED | {"svd"}]
    assert len(found) <= WITHOUT_EVIDENCE


# ------------------------------------------------- I: one registry of methods


def test_every_method_that_declares_itself_is_offered(house: House) -> None:
    declared = methods(house)
    assert len(declared) == len(set(declared)) > 0
    assert sorted(set(declared) - set(offered(house))) == []


def test_methods_are_listed_in_one_place(house: House) -> None:
    """A module that names six methods or more, beside the facade, is a list by hand: each declares itself."""
    own = set(methods(house)) | {name.replace("_", "-") for name in methods(house)}
    lists = [
        module.name
        for module in house.modules.values()
        if module.name != "residua.design" and len(own & (module.texts | module.names)) >= 6
    ]
    assert lists == []
