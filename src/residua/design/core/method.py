"""The registry of methods: needs and promises of a design function are declared beside the function.

A design is what maps measurements to residuals or estimates. A function is one, and declares itself, when what it
returns does so (``run``, ``estimate``), or has or makes what does (``generator``, ``residual_generator()``,
``observer``, the values of a mapping). Functions that return matrices, orders, thresholds, forms, a closed loop or a
choice among equations are tools beside them.
"""

from __future__ import annotations

import inspect
import re
import types
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from importlib import import_module
from typing import TYPE_CHECKING, Any, Literal, TypeVar, cast, get_args

import numpy as np

from residua.errors import ModelError, SettingError
from residua.plant import InputOutputModel, Plant
from residua.plant.balanced import is_singular
from residua.threads import in_one_thread
from residua.visible import echo

if TYPE_CHECKING:
    from residua.analysis.diagnosability import Diagnosability

#: What is designed for; only for a plant alone a function is tried by ``suggest``, and offered on the command line.
Subject = Literal["plant", "uncertain plant", "several plants", "model with parameters", "observer"]
#: What becomes of the noise of measurements, from the least that is left of it to the most.
Noise = Literal["least", "filtered", "unfiltered", "differentiated", "moving average"]
#: The time course of a fault for which its name holds.
TimeCourse = Literal["any", "step", "constant"]

Function = TypeVar("Function", bound=Callable[..., Any])
Calls = Callable[[Plant, "Diagnosability | None"], Iterable[Mapping[str, Any]]]


@dataclass(frozen=True)
class Need:
    """Something that a plant must have for a method to make sense.

    Attributes
    ----------
    text : str
        Its name.
    missing : callable
        Tells from a plant, and what is known of its faults, why the method makes no sense; empty if it does.
    """

    text: str
    missing: Callable[[Plant, Diagnosability | None], str]


@dataclass(frozen=True)
class Chosen:
    """An argument that is made from the plant when the user omits it.

    Attributes
    ----------
    make : callable
        Takes the plant and a time limit in seconds.
    code : str
        The same as a line of code.
    limited : str
        The same with a time limit, ``{seconds}``.
    """

    make: Callable[[Plant, float], Any]
    code: str
    limited: str


def one_call(plant: Plant, known: Diagnosability | None) -> Iterable[Mapping[str, Any]]:
    """Return the options to try for a plant: none."""
    return ({},)


@dataclass(frozen=True, eq=False)
class Method:
    """A design function, with its needs and promises.

    Attributes
    ----------
    function : callable
    designs_for : {"plant", "uncertain plant", "several plants", "model with parameters", "observer"}
        The kind of input that it takes.
    requirements : tuple of Need or str
        What that must have.
    condition : str
        When the design exists.
    order : str
        Number of states: ``n`` states, ``p`` independent outputs, ``k`` members, ``r`` residuals.
    source : str
        Where the method is from.
    state : str
        What it says about the state; empty when nothing.
    faults : str
        How it tells which fault it is; empty when it does not by itself.
    size : bool
        Whether it estimates how large a fault is.
    decouples : bool
        Whether the disturbances of the plant do not reach it.
    singular : bool
        Whether ``E`` may be singular.
    noise : {"least", "filtered", "unfiltered", "differentiated", "moving average"}
        What becomes of the noise of measurements.
    time_course : {"any", "step", "constant"}
        The time course of a fault for which its name holds.
    many : bool
        Whether it designs many filters, so that it takes long for a large plant.
    chosen : mapping of str to Chosen
        Arguments that are made from the plant when the user omits them.
    calls : callable
        The options with which it is tried for a plant.
    """

    function: Callable[..., Any] = field(repr=False)
    designs_for: Subject
    requirements: tuple[Need | str, ...] = field(repr=False)
    condition: str = field(repr=False)
    order: str = field(repr=False)
    source: str = field(repr=False)
    state: str = field(default="", repr=False)
    faults: str = field(default="", repr=False)
    size: bool = field(default=False, repr=False)
    decouples: bool = field(default=False, repr=False)
    singular: bool = field(default=False, repr=False)
    noise: Noise = field(default="filtered", repr=False)
    time_course: TimeCourse = field(default="any", repr=False)
    many: bool = field(default=False, repr=False)
    chosen: Mapping[str, Chosen] = field(default_factory=dict, repr=False)
    calls: Calls = field(default=one_call, repr=False)

    def with_chosen(
        self, plant: Plant, asked: Mapping[str, Any], known: dict[Chosen, Any], seconds: float
    ) -> dict[str, Any]:
        """Return arguments with those that are made from the plant, where they are not among them.

        ``made`` keeps these for other calls; each takes at most so many seconds.
        """
        arguments = dict(asked)
        for name, one in self.chosen.items():
            if name not in arguments:
                if one not in known:
                    known[one] = one.make(plant, seconds)
                arguments[name] = known[one]
        return arguments

    @property
    def name(self) -> str:
        """The name of the function."""
        return self.function.__name__

    @property
    def needs(self) -> str:
        """The needs of the plant, in words."""
        listed = ", ".join(one if isinstance(one, str) else one.text for one in self.requirements)
        return listed or "nothing more"

    @property
    def returns(self) -> str:
        """The name of the class of its result."""
        annotation = self.function.__annotations__.get("return", "")
        return annotation if isinstance(annotation, str) else getattr(annotation, "__name__", str(annotation))

    @cached_property
    def signature(self) -> inspect.Signature:
        """Its parameters and its result, as types."""
        return signature_of(self.function)

    @property
    def result(self) -> Any:
        """The class of its result."""
        return self.signature.return_annotation

    @cached_property
    def options(self) -> tuple[Option, ...]:
        """Its options, from its signature."""
        return options_of(self.function, self.signature)

    @cached_property
    def takes_a_plant(self) -> bool:
        """True if a plant is all that it is designed for."""
        first = next(iter(self.signature.parameters.values()))
        return self.designs_for == "plant" and Plant in kinds_of(first.annotation)

    @property
    def called(self) -> str:
        """Its call in a line of code."""
        ours = self.function.__module__.split(".")[0] == __name__.split(".")[0]
        return f"rs.design.{self.name}" if ours else self.name

    @property
    def place(self) -> tuple[Any, ...]:
        """Its place among others: observers, plain residuals, names, sizes; then the least noise first."""
        gives = 3 if self.size else 2 if self.faults else 0 if self.state else 1
        noise = get_args(Noise).index(self.noise)
        return self.designs_for != "plant", gives, noise, self.singular, self.name

    def missing(self, plant: Plant, known: Diagnosability | None = None) -> str:
        """Return why it makes no sense for a plant; empty if it does."""
        needs = (one for one in self.requirements if isinstance(one, Need))
        return next((why for why in (one.missing(plant, known) for one in needs) if why), "")

    def __reduce__(self) -> tuple[Any, ...]:
        return recorded, (self.name,)


#: All methods by name, as far as their modules are imported; :func:`residua.design.catalogue.methods` has them all.
METHODS: dict[str, Method] = {}


def check_design(record: Method, design: object) -> None:
    """Raise for a result of a method that cannot be a design: it is, has and makes nothing that runs."""
    if isinstance(design, Mapping) or any(hasattr(design, one) for one in _RUNS):
        return
    raise ModelError(
        f"{record.name} returned {type(design).__name__}, which is no design: it is, has and makes nothing that runs"
    )


#: What a design is, has or makes: a system of its own, an observer, or a generator.
_RUNS = ("system", "observer", "generator", "residual_generator")


def defect(record: Method, error: Exception) -> str:
    """Return the message on a method that raised an error that is no answer about a plant."""
    return f"{record.name} raised {type(error).__name__}: {error} (a defect of the method)"


def recorded(name: str) -> Method:
    """Return the method of a name that is registered, or will be once its module is imported."""
    if name not in METHODS:
        getattr(import_module("residua.design"), name)
    return METHODS[name]


def method(
    *,
    exists_when: str,
    order: str,
    source: str,
    needs: Iterable[Need | str] = (),
    designs_for: Subject = "plant",
    state: str = "",
    faults: str = "",
    size: bool = False,
    decouples: bool = False,
    singular: bool = False,
    noise: Noise = "filtered",
    time_course: TimeCourse = "any",
    many: bool = False,
    chosen: Mapping[str, Chosen] | None = None,
    calls: Calls = one_call,
) -> Callable[[Function], Function]:
    """Declare a design function: it is then in the tables, tried by ``suggest``, and offered on the command line.

    Use it as a decorator. The function runs in one thread of BLAS. What it returns, its options and their texts are
    read from its annotations and its numpydoc. On the command line stands what is designed for a plant alone and
    gives a :class:`residua.design.ResidualGenerator`, has one (``generator``) or makes one (``residual_generator()``).

    Parameters
    ----------
    exists_when : str
        The condition for its existence.
    order : str
        Number of states, in words.
    source : str
        Where the method is from.
    needs : sequence of Need or str
        What the plant must have: in words, or one of ``residua.design.core.method``, which can be asked of a plant.
    designs_for : {"plant", "uncertain plant", "several plants", "model with parameters", "observer"}
        Only what is for a plant alone is tried by ``suggest`` and offered on the command line.
    state : str
        What it says about the state; empty when nothing.
    faults : str
        How it tells which fault it is; empty when it does not by itself.
    size, decouples, singular : bool
        Whether it estimates the size of a fault, keeps disturbances out, and takes a singular ``E``.
    noise : {"least", "filtered", "unfiltered", "differentiated", "moving average"}
        What becomes of the noise of measurements.
    time_course : {"any", "step", "constant"}
        The time course of a fault for which its name holds.
    many : bool
        Whether it designs many filters.
    chosen : mapping of str to Chosen, optional
        Arguments that are made from the plant when the user omits them.
    calls : callable
        From a plant, and what is known of its faults, the options with which ``suggest`` tries it.

    Returns
    -------
    callable
        The decorator.

    Raises
    ------
    SettingError
        If another function has the name already, or the function takes nothing, does not say what it returns, or
        does not take a plant first where it designs for a plant; or an annotation names what its module does not
        have; or ``designs_for``, ``noise`` or ``time_course`` is none of its values.

    Examples
    --------
    >>> import residua as rs
    >>> from residua.design.catalogue import forget
    >>> @rs.design.method(exists_when="(C, A) detectable", order="n", source="this page", state="estimate")
    ... def slow_observer(plant: rs.Plant, *, margin: float = 0.1) -> rs.design.Observer:
    ...     return rs.design.luenberger_observer(plant, margin=margin)
    >>> any(entry.method.name == "slow_observer" for entry in rs.suggest(rs.library.vtol()).entries)
    True
    >>> forget("slow_observer")
    """

    def declare(plain: Function) -> Function:
        function = cast(Function, in_one_thread(plain))
        record = Method(
            function,
            designs_for,
            tuple(needs),
            exists_when,
            order,
            source,
            state,
            faults,
            size,
            decouples,
            singular,
            noise,
            time_course,
            many,
            dict(chosen or {}),
            calls,
        )
        _check(record)
        METHODS[record.name] = record
        return function

    return declare


def _check(record: Method) -> None:
    """Raise for a function that cannot be a method of this name, or has no annotation of its plant or its result."""
    name, parameters, other = record.name, tuple(record.signature.parameters.values()), METHODS.get(record.name)
    if not parameters:
        raise SettingError(f"{name} takes nothing: a design function takes a plant, or what it is designed for, first")
    for setting, kinds in (("designs_for", Subject), ("noise", Noise), ("time_course", TimeCourse)):
        value = getattr(record, setting)
        if value not in get_args(kinds):
            raise SettingError(f"{setting} must be one of {', '.join(get_args(kinds))}, got {echo(value)}")
    if record.result is None or record.result is inspect.Signature.empty:
        raise SettingError(
            f"{name} does not say what it returns: write '-> rs.design.Observer', or another class of designs"
        )
    if record.designs_for == "plant" and not {Plant, InputOutputModel} & set(kinds_of(parameters[0].annotation)):
        raise SettingError(
            f"{name} designs for a plant, but its first parameter is not annotated as one: "
            f"write '{parameters[0].name}: rs.Plant', or say what it designs for, designs_for=..."
        )
    places = [(one.__module__, one.__qualname__) for one in (record.function, other.function)] if other else []
    if len(set(places)) > 1:
        raise SettingError(f"the name {name!r} is that of {places[1][0]}: take another")


#: The beginning of a parameter in numpydoc: names, and what they are.
_HEAD = re.compile(r"^(?P<names>\w+(?:, \w+)*)(?: : (?P<kind>.*))?$")


@dataclass(frozen=True)
class Option:
    """A parameter of a design function beside the plant.

    Attributes
    ----------
    name : str
    annotation : type
        The type of its values.
    default : object
        ``inspect.Parameter.empty`` without one.
    text : str
        The text of its docstring.
    choices : tuple of str
        The texts that it may be, where only some are.
    """

    name: str
    annotation: Any
    default: Any
    text: str
    choices: tuple[str, ...]

    @property
    def required(self) -> bool:
        """True if it has no default."""
        return self.default is inspect.Parameter.empty

    @property
    def kinds(self) -> tuple[Any, ...]:
        """The types that it may be, each by itself."""
        return kinds_of(self.annotation)


def options_of(function: Callable[..., Any], signature: inspect.Signature) -> tuple[Option, ...]:
    """Return the options of a function with this signature: all parameters after the first but ``*args``, ``**kw``."""
    described, found = parameters_in(inspect.getdoc(function) or ""), []
    for one in list(signature.parameters.values())[1:]:
        if one.kind not in _ANY_NUMBER:
            kind, text = described.get(one.name, ("", ""))
            braces = re.match(r"\{(.*?)\}", kind)
            choices = re.findall(r'"([^"]*)"', braces[1]) if braces else []
            for part in kinds_of(one.annotation):
                if typing.get_origin(part) is typing.Literal:
                    choices += [value for value in typing.get_args(part) if isinstance(value, str)]
            found.append(Option(one.name, one.annotation, one.default, text, tuple(choices)))
    return tuple(found)


#: The kinds of parameters that stand for any number of arguments, none too.
_ANY_NUMBER = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)


def signature_of(function: Callable[..., Any]) -> inspect.Signature:
    """Return the signature of a function, its annotations as types; raise where one of them has no meaning."""
    try:
        return inspect.signature(function, eval_str=True)
    except Exception as error:  # an annotation is an expression of anybody's
        raise SettingError(
            f"the annotations of {function.__name__} cannot be read: {error}; import or define what they name above "
            "the function, and not under 'if TYPE_CHECKING:'"
        ) from error


def kinds_of(annotation: Any) -> tuple[Any, ...]:
    """Return the members of a union, those of its members too; any other type by itself."""
    annotation = getattr(annotation, "__value__", annotation)  # an alias by ``type``
    if isinstance(annotation, types.UnionType) or typing.get_origin(annotation) is typing.Union:
        return tuple(kind for part in typing.get_args(annotation) for kind in kinds_of(part))
    return (annotation,)


def parameters_in(docstring: str) -> Mapping[str, tuple[str, str]]:
    """Return the ``Parameters`` of a docstring: by name, the kind and the description."""
    lines = docstring.splitlines()
    title = next(
        (k for k in range(len(lines) - 1) if lines[k] == "Parameters" and lines[k + 1].startswith("---")), None
    )
    table: dict[str, tuple[str, str]] = {}
    if title is None:
        return table
    names: tuple[str, ...] = ()
    for k in range(title + 2, len(lines)):
        if k + 1 < len(lines) and lines[k + 1].startswith("---"):
            break
        head = _HEAD.match(lines[k])
        if head:
            names = tuple(head["names"].split(", "))
            table |= dict.fromkeys(names, (head["kind"] or "", ""))
        elif lines[k].strip():
            table |= {name: (table[name][0], f"{table[name][1]} {lines[k].strip()}".strip()) for name in names}
    return table


def _not_two_groups(plant: Plant, known: Diagnosability | None) -> str:
    if not plant.faults:
        return "the plant has no faults"
    if known is None:
        return "which of its faults can be told apart was not examined"
    return "" if len(known.groups) > 1 else "no two of its faults can be told apart"


def _has(text: str, has: Callable[[Plant], object], missing: str) -> Need:
    return Need(text, lambda plant, known: "" if has(plant) else missing)


NOISE = _has("noise", lambda plant: plant.noises, "the plant has no noise: give it with plant.with_noise(...)")
SAMPLED = _has("sampled", lambda plant: plant.is_discrete, "it counts samples: plant.discretize(dt) first")
FAULTS = _has("faults", lambda plant: plant.faults, "the plant has no faults")
SENSOR_FAULTS = _has("sensor faults", lambda plant: "sensor" in plant.fault_kinds, "the plant has no sensor faults")
ACTUATOR_FAULTS = _has(
    "actuator faults", lambda plant: "actuator" in plant.fault_kinds, "the plant has no actuator faults"
)
FAULTS_APART = Need("faults", _not_two_groups)


def disturbances(text: str, instead: str) -> Need:
    """Return the need of disturbances: its name, and the alternative for a plant without."""
    return _has(text, lambda plant: plant.disturbances, f"the plant has no disturbances: {instead}")


def each_scheme(plant: Plant, known: Diagnosability | None) -> Iterable[Mapping[str, Any]]:
    """Return both schemes of a bank."""
    return {"scheme": "generalized"}, {"scheme": "dedicated"}


def least_order_unless_singular(plant: Plant, known: Diagnosability | None) -> Iterable[Mapping[str, Any]]:
    """Return the option for the least order, where a plant has neither a singular ``E`` nor disturbances."""
    return ({} if is_singular(plant) or plant.disturbances else {"least_order": True},)


def groups_of_faults(plant: Plant, known: Diagnosability | None) -> Iterator[Mapping[str, Any]]:
    """Yield all faults, all of one kind, and each fault that is seen."""
    seen = plant.faults if known is None else tuple(np.asarray(plant.faults)[known.detectable].tolist())
    kinds = ("actuator", "sensor", "component")
    groups = [tuple(fault.name for fault in plant.fault_list if fault.kind == kind) for kind in kinds]
    for group in dict.fromkeys([plant.faults, *groups, *((name,) for name in seen)]):
        if group:
            yield {} if group == plant.faults else {"faults": group}
