"""Entry point of the command line: run the verb, return its exit code or print one line of error."""

from __future__ import annotations

import argparse
import difflib
import os
import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any, NoReturn

from appliance import __version__
from appliance.cli.arguments import Verb, collect, declare, suggestion
from appliance.cli.output import Exit, complain, flush, log_lines, say, use_any_encoding, write
from appliance.cli.verbs import SECTIONS, SOUGHT, VERBS, Group, VerbEntry

_MISSING = "the following arguments are required: "
_VALUELESS = re.compile(r"argument ([^:]+): expected (?:one|at least one) arguments?")
"""Argparse's sentence for a missing value, as in Python 3.11."""
_NO_CHOICE = re.compile(r"argument ([^:]+): invalid choice: '(.*)' \(choose from .*\)", re.DOTALL)
_NEGATIVE = re.compile(r"-\.?\d.*")
"""A value that begins with a minus. No option of ours begins with a digit."""


def main(argv: Sequence[str] | None = None) -> int:
    """Parse the command line, run the verb, return the exit code. Errors end as one line on stderr."""
    use_any_encoding()
    arguments = list(sys.argv[1:] if argv is None else argv)
    # Needed where argparse fails or has not begun: then only the words themselves show whether JSON is requested.
    as_json = "--json" in arguments
    try:
        try:
            return _run(arguments)
        finally:
            flush()  # help and version, too: a full disk is reported here, not by the interpreter at its end
    except BrokenPipeError:
        with suppress(OSError):
            sys.stdout.close()  # the reader of stdout went away, which is not our failure
        return Exit.OK
    except KeyboardInterrupt:
        return Exit.INTERRUPTED
    except Exception as error:
        from appliance.base import interrupts
        from appliance.cli.failures import exit_code_of

        if interrupts(error):
            return Exit.INTERRUPTED
        code = exit_code_of(error)
        if code is None:
            raise
        complain(str(error), as_json=as_json)
        return code


def _run(arguments: Sequence[str]) -> Exit:
    # `kingfisher help export` is usual for users of git.
    typed = _parser().parse_args([*arguments[1:], "--help"] if arguments[:1] == ["help"] else arguments)
    kind: type[Verb] = typed.verb
    verb = collect(kind, typed)
    with log_lines(as_json=verb.json, service=verb.says_news), _error_file(verb):
        if kind.kernels:
            from appliance.cli.kernels import find_kernels

            # Before any verb, because numba takes the folder of its cache from the first kernel that is imported.
            find_kernels()
        return verb.run()


@contextmanager
def _error_file(verb: Verb) -> Iterator[None]:
    if not verb.service:
        yield
        return
    from appliance.base import use_one_blas_thread
    from appliance.cli.failures import error_file_for_safe_screen

    use_one_blas_thread(os.environ)
    with error_file_for_safe_screen(os.environ):
        yield


class _Parser(argparse.ArgumentParser):
    """Argument parser with errors in one line and no abbreviations; ``--json`` counts even if parsing fails.

    The parser of a verb (``listed``) loads the verb and declares its arguments when it first parses.
    """

    def __init__(self, *, listed: VerbEntry | None = None, **settings: Any) -> None:
        super().__init__(allow_abbrev=False, **settings)
        self._listed = listed
        self._named_words: Sequence[str] = ()
        # Argparse takes "-5x3x1x1" for an option and reports a missing argument; this makes it a value, which is
        # checked.
        self._negative_number_matcher = _NEGATIVE

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Load the verb and declare its arguments, then parse like the base class. ``--help`` comes here, too."""
        if self._listed is not None:
            # Not earlier: with every verb loaded, `kingfisher --version` took half a second of CPU (ADR 0035).
            verb = self._listed.load()
            self._listed = None
            self.epilog = _exit_codes(*verb.codes)
            declare(verb, self)
            self.set_defaults(verb=verb)
            self._named_words = verb.named_words
        if self._named_words:
            for word in args:
                name = word.partition("=")[0].removeprefix("--")
                if word.startswith("--") and name in self._named_words:
                    self.error(f"--{name}: is written {name}=VALUE")
            # Argparse takes operands from one position only, but settings may stand anywhere.
            args = sorted(args, key=lambda word: word.partition("=")[0] not in self._named_words)
        typed, beyond = super().parse_known_args(args, namespace)
        if beyond:
            # Reported here, because the parser above does not have this verb's options.
            self.error("; ".join(map(self._not_known, beyond)))
        return typed, beyond

    def _not_known(self, word: str) -> str:
        option = word.partition("=")[0]
        if not option.startswith("-"):
            has_list = any(action.nargs in ("*", "+") for action in self._actions if not action.option_strings)
            return f"{word}: one word too many" + (
                "; give all operands together, without an option between them" if has_list else ""
            )
        return f"{option}: no such option" + suggestion(
            option, (text for action in self._actions for text in action.option_strings)
        )

    def _print_message(self, message: str, file: Any = None) -> None:
        # The base class ignores errors of writing the help.
        if file is sys.stdout and message:
            write(message)
        else:
            super()._print_message(message, file)

    def error(self, message: str) -> NoReturn:
        # Argparse failed, so that only the words themselves show whether JSON is requested.
        complain(f"{self._in_our_words(message)}; see `{self.prog} --help`", as_json="--json" in sys.argv[1:])
        raise SystemExit(Exit.USAGE)

    def _sought(self, word: str) -> str:
        """Return the verb that replaces ``word``, a verb of other programs or earlier versions; empty if unknown."""
        group = self.prog.removeprefix("kingfisher").strip()
        replacements = {key.rpartition(" ")[2]: verb for key, verb in SOUGHT.items() if key.rpartition(" ")[0] == group}
        near = difflib.get_close_matches(word, replacements, n=1)
        return f"; it is `kingfisher {replacements[near[0]]}`" if near else ""

    def _in_our_words(self, message: str) -> str:
        """Return argparse's message with the meaning of a missing argument, or the allowed choices."""
        missing = message.removeprefix(_MISSING)
        if missing != message:
            named = {_placeholder(action): action for action in self._actions if not action.option_strings}
            return "; ".join(f"{name} is missing, give it: {_meaning(named.get(name))}" for name in missing.split(", "))
        unknown = _NO_CHOICE.fullmatch(message)
        if unknown is not None:
            action = next(
                action
                for action in self._actions
                if unknown[1] in ("/".join(action.option_strings), _placeholder(action))
            )
            allowed = [str(choice) for choice in action.choices or ()]
            near = suggestion(unknown[2], allowed) or self._sought(unknown[2])
            # One similar word helps more than a long list.
            return f"{unknown[1]} {unknown[2]}: there is none" + (near or f"; there are: {', '.join(allowed)}")
        valueless = _VALUELESS.fullmatch(message)
        if valueless is None:
            return message.removeprefix("argument ")
        option = next(
            (
                candidate
                for candidate in self._actions
                if valueless[1] in ("/".join(candidate.option_strings), _placeholder(candidate))
            ),
            None,
        )
        return f"{valueless[1]} {_placeholder(option)}: the value is missing; {_meaning(option)}"


def _placeholder(action: argparse.Action | None) -> str:
    """Return the word for the value in ``--help``."""
    metavar = None if action is None else action.metavar
    if isinstance(metavar, str):
        return metavar
    return "VALUE" if action is None else action.dest.upper()


def _meaning(action: argparse.Action | None) -> str:
    """Return the description of a value in ``--help``, or its choices."""
    choices = None if action is None else action.choices
    if choices is not None:
        return f"one of {', '.join(map(str, choices))}"
    return (None if action is None else action.help) or "one word"


def _parser() -> _Parser:
    top = _Parser(
        prog="kingfisher",
        description=_overview(),
        epilog=_exit_codes(Exit.SCRIPT_FAILED, Exit.DAMAGED, Exit.LEFT_OUT),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    top.add_argument("--version", action=_Version, nargs=0, help="print the version and end")
    commands = top.add_subparsers(required=True, metavar="VERB", parser_class=_Parser)
    for entry in VERBS:
        if isinstance(entry, VerbEntry):
            commands.add_parser(entry.name, description=entry.text, listed=entry)
            continue
        group = commands.add_parser(entry.name, description=entry.text, epilog=_exit_codes())
        inner = group.add_subparsers(required=True, metavar="VERB", parser_class=_Parser)
        for listed in entry.verbs:
            inner.add_parser(listed.name, help=listed.text, description=listed.text, listed=listed)
    return top


class _Version(argparse.Action):
    def __call__(self, *_: object) -> NoReturn:
        from appliance.base import other_program

        say(f"kingfisher {__version__}")
        warning = other_program()
        if warning is not None:
            complain(warning, as_json="--json" in sys.argv[1:])
        raise SystemExit(Exit.OK)


def _overview() -> str:
    """Return the list of all verbs, one line each, below their headings."""
    lines = ["Handheld underwater 3D scanner. `kingfisher help VERB` describes a verb."]
    entries = {entry.name: entry for entry in VERBS}
    for heading, names in SECTIONS.items():
        lines += ["", f"{heading}:"]
        for entry in map(entries.__getitem__, names):
            more = f" ({', '.join(verb.name for verb in entry.verbs)})" if isinstance(entry, Group) else ""
            lines.append(f"  {entry.name:<12} {entry.text}{more}")
    return "\n".join(lines)


def _exit_codes(*more: Exit) -> str:
    """Return the end of a help text: the exit codes of every verb, and the ``more`` of one verb."""
    usual = (Exit.OK, Exit.FAILED, Exit.USAGE, *more, Exit.INTERRUPTED)
    return "exit codes: " + ", ".join(f"{code.value} {code.name.lower().replace('_', ' ')}" for code in usual)
