"""Choice of a design method and its options, with reasons, from the registry of methods."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from residua.analysis import coding
from residua.cli.option_types import Form, form_of, in_plain_words
from residua.design.banks.structured_bank import ROWS
from residua.design.catalogue import methods
from residua.design.core.generator import brings_a_generator, for_monitor
from residua.design.core.method import NOISE, SAMPLED, Chosen, Method, Option, check_design, defect
from residua.design.suggestion import first_design
from residua.errors import AccuracyError, DesignError, ModelError, ResiduaError, SettingError
from residua.plant import Plant
from residua.words import listing

AUTO = "auto"
#: Seconds for the choice of a coding set, whose search then takes the best one so far; and for the other methods after
#: a refusal.
CHOICE_TIME, TRYING_TIME = 10.0, 30.0


class MethodError(ResiduaError):
    """A method raised an error that is not a statement about a plant."""


class OptionError(ValueError):
    """An option with unreadable text."""

    def __init__(self, option: str, why: str) -> None:
        super().__init__(f"{option}: {why}")
        self.option, self.why = option, why


def option_name(name: str) -> str:
    """Return the name of an argument on the command line; letters of the literature stay unchanged."""
    return f"--{name.replace('_', '-')}"


def flag(option: Option) -> str:
    """Return an option of a method as written on the command line."""
    return option_name(option.name)


def method_name(method: Method) -> str:
    """Return the name of a method on the command line."""
    return method.name.replace("_", "-")


def offered() -> dict[str, Method]:
    """Return the methods that a plant file and options can supply, with results for a monitor, by name."""
    return {method_name(one): one for one in methods() if not in_python_only(one)}


def in_python_only(method: Method) -> str:
    """Return the reason why a method is not offered here; empty if it is."""
    if not method.takes_a_plant:
        kind = method.designs_for
        article = "" if kind.endswith("s") and "with" not in kind else "an " if kind[0] in "aeiou" else "a "
        return f"for {article}{kind}"
    unsaid = [one.name for one in method.options if one.required and one.name not in method.chosen and not form_of(one)]
    if unsaid:
        return f"needs {', '.join(unsaid)}"
    return "" if brings_a_generator(method.result) else f"a monitor cannot run {method.returns}"


@dataclass(frozen=True)
class Shared:
    """An option of the command line shared by one or more methods.

    Attributes
    ----------
    name : str
        The name of the argument.
    flags : tuple of str
        The words on the command line.
    form : Form
        The form in the first method that has it.
    text : str
        Description that most of the methods share.
    methods : tuple of str
        Which have it.
    """

    name: str
    flags: tuple[str, ...]
    form: Form
    text: str
    methods: tuple[str, ...]


def options(taken: Iterable[str] = ()) -> list[Shared]:
    """Return every option of every method, except for reserved names."""
    holders_of: dict[str, list[tuple[str, Option, Form]]] = {}
    for name, method in offered().items():
        for option in method.options:
            form = form_of(option)
            if form is not None and option.name not in taken:
                holders_of.setdefault(option.name, []).append((name, option, form))
    return [_shared(name, holders) for name, holders in holders_of.items()]


def _shared(name: str, holders: list[tuple[str, Option, Form]]) -> Shared:
    form = holders[0][2]
    texts = Counter(one.text for _, one, _ in holders)
    text = max(texts, key=lambda one: (bool(one), texts[one], len(one)))
    plain = option_name(name)
    flags = (f"{plain}/--no-{plain[2:]}",) if form.is_flag else (plain,)
    if any(other.is_flag != form.is_flag for _, _, other in holders):  # of one name and two kinds: each reads its text
        form, flags = Form("TEXT", str), (plain,)
    return Shared(name, flags, form, in_plain_words(text), tuple(one for one, _, _ in holders))


@dataclass(frozen=True)
class Call:
    """A design: a method with its options.

    Attributes
    ----------
    method : Method
    values : mapping of str to value
        Options that were asked for.
    dt : float or None
        Of the recordings.
    settings : mapping of str to value
        Of the monitor: a method takes those that it has an option for.
    subject : str
        Object of the design, as a line of Python.
    made : dict
        Arguments that were made from the plant, which other calls share.
    """

    method: Method
    values: Mapping[str, Any]
    dt: float | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)
    subject: str = "plant"
    made: dict[Chosen, Any] = field(default_factory=dict, repr=False)

    @property
    def asked(self) -> dict[str, Any]:
        """Arguments of the call, besides those from the plant."""
        names = {one.name for one in self.method.options}
        return {**self.values, **{name: value for name, value in self.settings.items() if name in names}}

    @property
    def left_out(self) -> list[str]:
        """Required arguments that were not given."""
        chosen = {*self.asked, *self.method.chosen}
        return [one.name for one in self.method.options if one.required and one.name not in chosen]

    def run(self, plant: Plant) -> Any:
        """Make the call, and return the part for a monitor."""
        asked = self.method.with_chosen(plant, self.asked, self.made, CHOICE_TIME)
        try:
            made = self.method.function(self._of_the_time(plant), **asked)
            check_design(self.method, made)
            return for_monitor(made)
        except (ResiduaError, MemoryError):
            raise
        except Exception as error:
            raise MethodError(defect(self.method, error)) from error

    def _sampled(self, plant: Plant) -> bool:
        """True if the plant is sampled first: the best filter of that, rather than the continuous one, sampled."""
        needs = self.method.requirements
        noise = NOISE in needs and bool(plant.Bw.shape[1])
        return self.dt is not None and not plant.is_discrete and (noise or SAMPLED in needs)

    def _of_the_time(self, plant: Plant) -> Plant:
        if self.dt is not None and self._sampled(plant):
            return plant.discretize(self.dt)
        if SAMPLED in self.method.requirements and not plant.is_discrete:
            raise DesignError("it counts samples: give --dt, the step of the recordings")
        return plant

    def code(self, plant: Plant) -> str:
        """Return the equivalent Python code, for a plant called ``plant``."""
        sampled = f"plant.discretize({self.dt!r})" if self._sampled(plant) else self.subject
        made = [
            f"{name}={one.limited.format(seconds=CHOICE_TIME)}"
            for name, one in self.method.chosen.items()
            if name not in self.values
        ]
        arguments = [f"{name}={_with_real_numbers(value)!r}" for name, value in self.asked.items()]
        return f"{self.method.called}({', '.join([sampled, *made, *arguments])})"


def _with_real_numbers(value: Any) -> Any:
    """Return a value, or a list or mapping of values, in which complex numbers without an imaginary part are real."""
    if isinstance(value, Mapping):
        return {name: _with_real_numbers(one) for name, one in value.items()}
    if isinstance(value, (list, tuple)):
        return type(value)(_with_real_numbers(one) for one in value)
    return value.real if isinstance(value, complex) and not value.imag else value


def choose(plant: Plant, dt: float | None) -> tuple[Plant, str, Call, str]:
    """Return the plant to design for, the method ranked first by :func:`residua.suggest`, its call, and the reason.

    Parameters
    ----------
    plant : Plant
    dt : float or None
        Of the recordings: a continuous plant is sampled with it first.

    Raises
    ------
    DesignError
        If nothing can come first.
    """
    subject = "plant"
    if dt is not None and not plant.is_discrete:
        plant, subject = plant.discretize(dt), f"plant.discretize({dt!r})"
    found = first_design(plant)
    best = found.best
    if best is None:
        tried = [f"{one.method.name}: {one.left_out or one.reason}" for one in found.entries if one.works is not None]
        raise DesignError(f"no design can see the faults of this plant: {'; '.join([*found.notes, *tried])}")
    why = "it estimates the state; the plant has no faults"
    if best.sizes:
        why = (
            f"it sees lasting faults from these sizes on (in brackets: deviations of the noise): {found.seen_by(best)}"
        )
    if ".with_assumed_noise()" in best.call:
        plant, subject = plant.with_assumed_noise(), f"{subject}.with_assumed_noise()"
        why += "; the plant has no noise, so some is assumed: fit the monitor to fault-free data"
    return plant, method_name(best.method), Call(best.method, best.options, None, subject=subject), why


def call_of(name: str, asked: Mapping[str, Any], settings: Mapping[str, Any], dt: float | None) -> Call:
    """Return a method with its options.

    Parameters
    ----------
    name : str
    asked : mapping of str to str or bool
        Options as they were written.
    settings : mapping of str to value
        Of the monitor: a method takes those that it has too.
    dt : float or None

    Raises
    ------
    SettingError
        If the method does not have an option, or needs one that is not there.
    OptionError
        If the text of an option cannot be read.
    """
    known = offered()
    method = known[name]
    own = {one.name: one for one in method.options if form_of(one) is not None}
    for option in asked:
        if option not in own:
            raise SettingError(_not_of(option, name))
    values = {option: _read(own[option], value) for option, value in asked.items()}
    call = Call(method, values, dt, settings)
    if call.left_out:
        needed = next(one for one in method.options if one.name == call.left_out[0])
        form = form_of(needed)
        assert form is not None
        raise SettingError(f"{name} needs {flag(needed)} {form.metavar}: {in_plain_words(needed.text)}")
    return call


def _not_of(option: str, name: str) -> str:
    one = next(one for one in options() if one.name == option)
    written = one.flags[0].partition("/")[0]
    return f"{written} is for --method {listing(one.methods)}, not for {name}"


def _read(option: Option, value: Any) -> Any:
    form = form_of(option)
    assert form is not None
    try:
        return form.read(value)
    except ValueError as error:
        raise OptionError(flag(option), str(error)) from None


def make(plant: Plant, name: str, call: Call, *, why: str = "") -> Any:
    """Design by one method, or raise with the reason and the other methods that would work.

    Parameters
    ----------
    plant : Plant
    name : str
        Of the method.
    call : Call
    why : str
        Why the method was chosen, for the message.

    Returns
    -------
    ResidualGenerator, or a design that has one

    Raises
    ------
    DesignError
    """
    for option, chosen in call.method.chosen.items():
        if chosen is ROWS and option in call.values:  # a slip in these says nothing about other methods
            coding.CodingSet.of(call.values[option], plant.faults)
    try:
        return call.run(plant)
    except (DesignError, AccuracyError) as error:
        chosen = f"{name} (chosen because {why})" if why else name
        raise type(error)(f"{chosen}: {error}; {_remedy(plant, name, call)}") from error
    except SettingError as error:  # an option is wrong: that says nothing about other methods
        raise SettingError(f"{name}: {error}") from error


def _remedy(plant: Plant, name: str, call: Call) -> str:
    """Return the options to remove for the method to work, or the other methods that exist."""
    kept = {option.name for option in call.method.options if option.required} - set(call.method.chosen)
    dropped = [option for option in call.method.options if option.name in call.values and option.name not in kept]
    if dropped and _exists(_without_options(call, call.method, kept), plant):
        return f"without {listing(flag(one) for one in dropped)} {name} exists for this plant"
    needed = tuple(flag(option) for option in call.method.options if option.name in call.values and option.name in kept)
    doubt = f"{name} needs {listing(needed)}, and another value may do; " if needed else ""
    return doubt + _alternatives(plant, name, call)


def _without_options(call: Call, method: Method, kept: Iterable[str] = ()) -> Call:
    """Return a call of a method with the defaults of its options, except for those to keep."""
    values = {name: value for name, value in call.values.items() if name in kept}
    return Call(method, values, call.dt, call.settings, call.subject, call.made)


def _alternatives(plant: Plant, failed: str, call: Call) -> str:
    """Return the other methods that exist for this plant, with the defaults of their options."""
    possible, late, end = [], [], time.monotonic() + TRYING_TIME
    for name, method in offered().items():
        other = _without_options(call, method)
        if name == failed or other.left_out:
            continue
        if time.monotonic() > end:
            late.append(name)
        elif _exists(other, plant):
            exposed = plant.disturbances and not method.decouples
            possible.append(f"--method {name}{' (does not decouple the disturbances)' if exposed else ''}")
    untried = f"; not tried, for lack of time: {', '.join(late)}" if late else ""
    if possible:
        return f"methods that exist for this plant: {', '.join(possible)}{untried}"
    return f"no other method exists for this plant either{untried}"


def _exists(call: Call, plant: Plant) -> bool:
    try:
        call.run(plant)
    except (DesignError, AccuracyError, SettingError, ModelError, MethodError):
        return False
    return True


HEADER = ("method", "needs", "exists when", "options")


def table() -> list[tuple[str, ...]]:
    """Return requirements and options of each method, as rows under :data:`HEADER`."""
    rows = []
    for name, method in offered().items():
        flags = [flag(one) for one in method.options if form_of(one) is not None]
        rows.append((name, method.needs, method.condition, " ".join(flags)))
    return rows
