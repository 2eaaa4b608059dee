"""Declarations of what may be typed after a verb: once, as the fields of a frozen dataclass.

A field's name, type and default are those of the value that the verb works with; ``option``, ``switch``, ``operand``
and ``operands`` add how it is typed and what ``--help`` says about it. ``declare`` hands the fields to ``argparse``,
``collect`` makes the dataclass from what was typed. Nothing of the product is imported here: every call of
``kingfisher`` loads this file."""

from __future__ import annotations

import argparse
import difflib
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, ClassVar, TypeVar

from appliance.cli.output import Exit, say, say_json, say_report

_KEY = "typed"
"""Key in a field's metadata under which its ``_Typed`` is found."""
_MOST_DIGITS = 9


@dataclass(frozen=True, slots=True)
class _Typed:
    """The way in which a field is typed."""

    flag: str | None
    """``--out``; ``None``: its place says what it is."""
    settings: Mapping[str, Any]
    """Keyword arguments for ``add_argument``."""
    either: str | None
    """Name of a group of options of which at most one may be typed; ``None``: it belongs to no group."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Verb:
    """A verb with everything that was typed after it. ``run`` does the work and answers the exit code."""

    codes: ClassVar[Sequence[Exit]] = ()
    """Exit codes that only this verb has, for ``--help``."""
    service: ClassVar[bool] = False
    """True if the verb is the instrument itself: it says its news, and an error that ends it is kept for the safe
    screen."""
    kernels: ClassVar[bool] = True
    """False: nothing that the verb may import has compiled kernels, so that nobody looks where they are kept."""

    json: bool = field(
        default=False,
        metadata={_KEY: _Typed("--json", {"action": "store_true", "help": "print one JSON document"}, None)},
    )

    named_words: ClassVar[Sequence[str]] = ()
    """Names that are typed as ``NAME=VALUE``, for whoever types ``--NAME``."""

    @property
    def says_news(self) -> bool:
        """True if what it logs besides warnings is printed, too."""
        return self.service

    def tell(self, result: Any, lines: Iterable[str] | None = None) -> None:
        """Print what came of it: with ``--json`` as one document, else in ``lines``, or one value a line where none are
        given."""
        if self.json:
            say_json(result)
        elif lines is None:
            say_report(result)
        else:
            for line in lines:
                say(line)

    def run(self) -> Exit:
        """Do it. Errors that a person can do something about are raised (``appliance.cli.failures``)."""
        raise NotImplementedError


V = TypeVar("V", bound=Verb)


def option(
    flag: str,
    text: str | None,
    *,
    default: Any = None,
    parse: Callable[[str], Any] | None = None,
    metavar: str | None = None,
    choices: Sequence[str] | None = None,
    either: str | None = None,
) -> Any:
    """Return a field whose value is typed after ``flag``. ``parse`` raises ``ArgumentTypeError``; ``text`` is for
    ``--help``."""
    settings = {"help": text, "type": parse, "metavar": metavar, "choices": choices}
    given = {name: value for name, value in settings.items() if value is not None}
    return field(default=default, metadata={_KEY: _Typed(flag, given, either)})


def path_option(flag: str, text: str, *, metavar: str = "FILE", either: str | None = None) -> Any:
    """Return a field whose value is the path that is typed after ``flag``; ``None`` where it was not typed."""
    return option(flag, text, parse=Path, metavar=metavar, either=either)


def repeated(flag: str, text: str, *, metavar: str) -> Any:
    """Return a tuple of what was typed after each ``flag``, in that order; empty where it was not typed."""
    settings = {"help": text, "metavar": metavar, "action": "append"}
    return field(default=(), metadata={_KEY: _Typed(flag, settings, None)})


def switch(flag: str, text: str, *, either: str | None = None) -> Any:
    """Return a field that is true where ``flag`` was typed."""
    return field(default=False, metadata={_KEY: _Typed(flag, {"action": "store_true", "help": text}, either)})


def operand(
    metavar: str,
    text: str | None,
    *,
    parse: Callable[[str], Any] = str,
    optional: bool = False,
    choices: Sequence[str] | None = None,
) -> Any:
    """Return a field that its place names; ``optional``: ``None`` where nothing stands there."""
    settings = {"metavar": metavar, "help": text, "type": parse, "choices": choices}
    if optional:
        settings["nargs"] = "?"
    typed = {_KEY: _Typed(None, settings, None)}
    return field(default=None, metadata=typed) if optional else field(metadata=typed)


def operands(metavar: str, text: str, *, at_least_one: bool, parse: Callable[[str], Any] = str) -> Any:
    """Return a tuple of all words that stand there."""
    settings = {"metavar": metavar, "help": text, "type": parse, "nargs": "+" if at_least_one else "*"}
    return field(metadata={_KEY: _Typed(None, settings, None)})


def declare(verb: type[Verb], parser: argparse.ArgumentParser) -> None:
    """Give ``parser`` an argument for each field of ``verb``, those of its base classes first."""
    groups: dict[str, argparse._MutuallyExclusiveGroup] = {}
    for one in fields(verb):
        # A field without it cannot be typed: KeyError, as soon as the verb is first asked for, where a field forgot to
        # say how.
        typed: _Typed = one.metadata[_KEY]
        if typed.either is not None and typed.either not in groups:
            groups[typed.either] = parser.add_mutually_exclusive_group()
        where = parser if typed.either is None else groups[typed.either]
        if typed.flag is None:
            where.add_argument(one.name, **typed.settings)
        else:  # argparse appends to the default itself, so that a repeated option begins with nothing
            default = None if typed.settings.get("action") == "append" else one.default
            where.add_argument(typed.flag, dest=one.name, default=default, **typed.settings)


def collect(verb: type[V], typed: argparse.Namespace) -> V:
    """Return the verb with what ``declare``'s parser found."""
    found = {one.name: getattr(typed, one.name) for one in fields(verb)}
    for one in fields(verb):
        if found[one.name] is None:
            # None is what argparse leaves where nothing was typed: the default for most fields, but for a repeated
            # option an empty tuple.
            found[one.name] = () if one.default == () else None
        elif isinstance(found[one.name], list):
            found[one.name] = tuple(found[one.name])
    return verb(**found)


def meant(word: str, there: Iterable[str]) -> str:
    """Return a question for what a mistyped word is near to; empty where it is near to nothing."""
    near = difflib.get_close_matches(word, list(there), n=2)
    return f"; did you mean {' or '.join(near)}?" if near else ""


# ------------------------------------------------------------------------------------------ numbers


def whole(low: int, high: int) -> Callable[[str], int]:
    """Return a parser of whole numbers ``low`` to ``high``, at most nine digits."""

    def parse(text: str) -> int:
        # Judged as text first: int() takes "٣", "1_000" and " 5 " as well, and refuses more than 4300 digits with an
        # error of its own.
        digits = text.lstrip("0") or "0"
        if not (text.isascii() and text.isdigit() and len(digits) <= _MOST_DIGITS and low <= int(digits) <= high):
            raise argparse.ArgumentTypeError(f"{text}: allowed are whole numbers {low}..{high}")
        return int(digits)

    return parse


def number(low: float, high: float, unit: str | None = None) -> Callable[[str], float]:
    """Return a parser of numbers ``low`` to ``high``; ``unit`` is named where the option's own name does not."""
    allowed = f"{low:g}..{high:g}" if unit is None else f"numbers {low:g}..{high:g} ({unit})"
    return _judged(lambda value: low <= value <= high, allowed)


def number_above(low: float, high: float) -> Callable[[str], float]:
    """Return a parser of numbers greater than ``low``, up to ``high``."""
    return _judged(lambda value: low < value <= high, f"numbers above {low:g}, up to {high:g}")


def _judged(fits: Callable[[float], bool], allowed: str) -> Callable[[str], float]:
    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            # NaN fits no range, and so does "nan" where it is typed: both end in the same line.
            value = math.nan
        if not fits(value):
            raise argparse.ArgumentTypeError(f"{text}: allowed are {allowed}")
        return value

    return parse


def one_of(allowed: Sequence[str]) -> Callable[[str], str]:
    """Return a parser of the words ``allowed``."""

    def parse(text: str) -> str:
        if text not in allowed:
            raise argparse.ArgumentTypeError(f"{text}: allowed are {', '.join(allowed)}")
        return text

    return parse
