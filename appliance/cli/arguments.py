"""Declarations of the arguments of a verb, as the fields of a frozen dataclass.

A field's name, type and default are those of the value that the verb works with; ``option``, ``switch``, ``operand``
and ``operands`` add how it is typed and its text in ``--help``. ``declare`` passes the fields to ``argparse``,
``collect`` makes the dataclass from the parsed arguments. No other module of the product is imported here, because
every call of ``kingfisher`` loads this file.
"""

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
"""Key of the ``_Argument`` in a field's metadata."""
_MOST_DIGITS = 9


@dataclass(frozen=True, slots=True)
class _Argument:
    """Form in which a field is typed on the command line."""

    flag: str | None
    """``--out``; ``None`` for an operand, which its position names."""
    settings: Mapping[str, Any]
    """Keyword arguments for ``add_argument``."""
    either: str | None
    """Name of a group of options that exclude each other; ``None`` without one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Verb:
    """A verb with its arguments. ``run`` does the work and returns the exit code."""

    codes: ClassVar[Sequence[Exit]] = ()
    """Exit codes that only this verb has, for ``--help``."""
    service: ClassVar[bool] = False
    """True if the verb is the instrument itself: it prints its log, and an error that ends it is kept for the safe
    screen."""
    kernels: ClassVar[bool] = True
    """False if the verb imports no compiled kernels, so that their folder is not searched."""

    json: bool = field(
        default=False,
        metadata={_KEY: _Argument("--json", {"action": "store_true", "help": "print one JSON document"}, None)},
    )

    named_words: ClassVar[Sequence[str]] = ()
    """Names that are typed as ``NAME=VALUE``, for the error after ``--NAME``."""

    @property
    def says_news(self) -> bool:
        """True if log entries below warnings are printed, too."""
        return self.service

    def tell(self, result: Any, lines: Iterable[str] | None = None) -> None:
        """Print the result: one document with ``--json``, else ``lines``, or one value a line without them."""
        if self.json:
            say_json(result)
        elif lines is None:
            say_report(result)
        else:
            for line in lines:
                say(line)

    def run(self) -> Exit:
        """Do the work. Errors that a person can cure are raised (``appliance.cli.failures``)."""
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
    """Return a field whose value is typed after ``flag``.

    ``parse`` raises ``ArgumentTypeError``; ``text`` is for ``--help``.
    """
    settings = {"help": text, "type": parse, "metavar": metavar, "choices": choices}
    used_settings = {name: value for name, value in settings.items() if value is not None}
    return field(default=default, metadata={_KEY: _Argument(flag, used_settings, either)})


def path_option(flag: str, text: str, *, metavar: str = "FILE", either: str | None = None) -> Any:
    """Return a field whose value is the path after ``flag``; ``None`` without it."""
    return option(flag, text, parse=Path, metavar=metavar, either=either)


def repeated(flag: str, text: str, *, metavar: str) -> Any:
    """Return a field with the tuple of all values after ``flag``, in their order; empty without it."""
    settings = {"help": text, "metavar": metavar, "action": "append"}
    return field(default=(), metadata={_KEY: _Argument(flag, settings, None)})


def switch(flag: str, text: str, *, either: str | None = None) -> Any:
    """Return a field that is true if ``flag`` was typed."""
    return field(default=False, metadata={_KEY: _Argument(flag, {"action": "store_true", "help": text}, either)})


def operand(
    metavar: str,
    text: str | None,
    *,
    parse: Callable[[str], Any] = str,
    optional: bool = False,
    choices: Sequence[str] | None = None,
) -> Any:
    """Return a field that is named by its position; an ``optional`` one may be ``None``."""
    settings = {"metavar": metavar, "help": text, "type": parse, "choices": choices}
    if optional:
        settings["nargs"] = "?"
    typed = {_KEY: _Argument(None, settings, None)}
    return field(default=None, metadata=typed) if optional else field(metadata=typed)


def operands(metavar: str, text: str, *, at_least_one: bool, parse: Callable[[str], Any] = str) -> Any:
    """Return a field with the tuple of all words in its position."""
    settings = {"metavar": metavar, "help": text, "type": parse, "nargs": "+" if at_least_one else "*"}
    return field(metadata={_KEY: _Argument(None, settings, None)})


def declare(verb: type[Verb], parser: argparse.ArgumentParser) -> None:
    """Add an argument to ``parser`` for each field of ``verb``, those of its base classes first."""
    groups: dict[str, argparse._MutuallyExclusiveGroup] = {}
    for item in fields(verb):
        # A field without an argument is a KeyError when the verb is loaded.
        argument: _Argument = item.metadata[_KEY]
        if argument.either is not None and argument.either not in groups:
            groups[argument.either] = parser.add_mutually_exclusive_group()
        target = parser if argument.either is None else groups[argument.either]
        if argument.flag is None:
            target.add_argument(item.name, **argument.settings)
        else:  # argparse appends to the default itself, so that a repeated option begins with nothing
            default = None if argument.settings.get("action") == "append" else item.default
            target.add_argument(argument.flag, dest=item.name, default=default, **argument.settings)


def collect(verb: type[V], typed: argparse.Namespace) -> V:
    """Return the verb with the arguments that ``declare``'s parser parsed."""
    values = {item.name: getattr(typed, item.name) for item in fields(verb)}
    for item in fields(verb):
        if values[item.name] is None:
            # Argparse leaves None for an argument that was not typed: the default of most fields, but of a repeated
            # option an empty tuple.
            values[item.name] = () if item.default == () else None
        elif isinstance(values[item.name], list):
            values[item.name] = tuple(values[item.name])
    return verb(**values)


def suggestion(word: str, candidates: Iterable[str]) -> str:
    """Return a question with the words that ``word`` resembles; empty without such a word."""
    near = difflib.get_close_matches(word, list(candidates), n=2)
    return f"; did you mean {' or '.join(near)}?" if near else ""


# ------------------------------------------------------------------------------------------ numbers


def whole_number(low: int, high: int) -> Callable[[str], int]:
    """Return a parser of whole numbers ``low`` to ``high``, at most nine digits."""

    def parse(text: str) -> int:
        # Checked as text first: int() also accepts "٣", "1_000" and " 5 ", and rejects more than 4300 digits with its
        # own error.
        digits = text.lstrip("0") or "0"
        if not (text.isascii() and text.isdigit() and len(digits) <= _MOST_DIGITS and low <= int(digits) <= high):
            raise argparse.ArgumentTypeError(f"{text}: allowed are whole numbers {low}..{high}")
        return int(digits)

    return parse


def number(low: float, high: float, unit: str | None = None) -> Callable[[str], float]:
    """Return a parser of numbers ``low`` to ``high``; ``unit`` is for options whose name lacks it."""
    allowed = f"{low:g}..{high:g}" if unit is None else f"numbers {low:g}..{high:g} ({unit})"
    return _number_parser(lambda value: low <= value <= high, allowed)


def number_above(low: float, high: float) -> Callable[[str], float]:
    """Return a parser of numbers greater than ``low``, up to ``high``."""
    return _number_parser(lambda value: low < value <= high, f"numbers above {low:g}, up to {high:g}")


def _number_parser(is_allowed: Callable[[float], bool], allowed: str) -> Callable[[str], float]:
    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            # NaN is in no range, like a typed "nan": both end in the same error.
            value = math.nan
        if not is_allowed(value):
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
