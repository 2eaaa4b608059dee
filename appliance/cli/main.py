"""A command line is taken apart, and a verb run to its end: its exit code, or one line that says what is wrong."""

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
from appliance.cli.arguments import Verb, collect, declare, meant
from appliance.cli.output import Exit, complain, flush, log_lines, say, use_any_encoding, write
from appliance.cli.verbs import SECTIONS, SOUGHT, VERBS, Group, Listed

_MISSING = "the following arguments are required: "
_VALUELESS = re.compile(r"argument ([^:]+): expected (?:one|at least one) arguments?")
"""Argparse's words for what is missing, as Python 3.11 has them."""
_NO_CHOICE = re.compile(r"argument ([^:]+): invalid choice: '(.*)' \(choose from .*\)", re.DOTALL)
_NEGATIVE = re.compile(r"-\.?\d.*")
"""A value that begins with a minus, and no option: none of ours begins with a digit."""


def main(argv: Sequence[str] | None = None) -> int:
    """Parse, run the verb, return the exit code. Errors end as one line on stderr."""
    use_any_encoding()
    words = list(sys.argv[1:] if argv is None else argv)
    # Argparse failed or has not begun, then: whether JSON is wanted can only be looked for among the words.
    as_json = "--json" in words
    try:
        try:
            return _run(words)
        finally:
            flush()  # help and version, too: a full disk is told here, and not by the interpreter at its end
    except BrokenPipeError:
        with suppress(OSError):
            sys.stdout.close()  # the reader of stdout went away: not our failure, and nobody to tell
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


def _run(words: Sequence[str]) -> Exit:
    # `kingfisher help export` is what people try who come from git.
    typed = _parser().parse_args([*words[1:], "--help"] if words[:1] == ["help"] else words)
    kind: type[Verb] = typed.verb
    verb = collect(kind, typed)
    with log_lines(as_json=verb.json, service=verb.says_news), _last_words(verb):
        if kind.kernels:
            from appliance.cli.kernels import find_kernels

            # Before any verb, since numba takes the folder of its cache from the first kernel that is imported,
            # wherever that is.
            find_kernels()
        return verb.run()


@contextmanager
def _last_words(verb: Verb) -> Iterator[None]:
    if not verb.service:
        yield
        return
    from appliance.base import use_one_blas_thread
    from appliance.cli.failures import last_words

    use_one_blas_thread(os.environ)
    with last_words(os.environ):
        yield


class _Parser(argparse.ArgumentParser):
    """Errors in one line, no abbreviations; ``--json`` is honoured even where the rest does not parse.

    That of a verb (``listed``) loads it, and declares its arguments, when it is first asked to parse.
    """

    def __init__(self, *, listed: Listed | None = None, **settings: Any) -> None:
        super().__init__(allow_abbrev=False, **settings)
        self._listed = listed
        self._named_words: Sequence[str] = ()
        # argparse takes "-5x3x1x1" for an option and says "expected one argument": let the value be judged instead.
        self._negative_number_matcher = _NEGATIVE

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse like the base class, once the verb is loaded and its arguments are declared; ``--help`` comes here,
        too."""
        if self._listed is not None:
            # Not before: with every verb loaded, `kingfisher --version` took half a second of CPU (ADR 0035).
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
            # Argparse takes operands from one place: settings may stand anywhere.
            args = sorted(args, key=lambda word: word.partition("=")[0] not in self._named_words)
        typed, beyond = super().parse_known_args(args, namespace)
        if beyond:
            # Here and not in the parser above, which knows nothing of this verb's options.
            self.error("; ".join(map(self._not_known, beyond)))
        return typed, beyond

    def _not_known(self, word: str) -> str:
        option = word.partition("=")[0]
        if not option.startswith("-"):
            apart = any(one.nargs in ("*", "+") for one in self._actions if not one.option_strings)
            return f"{word}: one word too many" + (
                "; give it beside the others, with no option between" if apart else ""
            )
        return f"{option}: no such option" + meant(
            option, (text for one in self._actions for text in one.option_strings)
        )

    def _print_message(self, message: str, file: Any = None) -> None:
        # The base class says nothing where help cannot be written.
        if file is sys.stdout and message:
            write(message)
        else:
            super()._print_message(message, file)

    def error(self, message: str) -> NoReturn:
        # argparse failed, so that nothing was parsed: whether JSON is wanted can only be looked for among the words.
        complain(f"{self._in_our_words(message)}; see `{self.prog} --help`", as_json="--json" in sys.argv[1:])
        raise SystemExit(Exit.USAGE)

    def _sought(self, word: str) -> str:
        """Return what does what somebody means by ``word``, who knows no verb of that name; empty where nothing is
        known of it."""
        group = self.prog.removeprefix("kingfisher").strip()
        words = {key.rpartition(" ")[2]: verb for key, verb in SOUGHT.items() if key.rpartition(" ")[0] == group}
        near = difflib.get_close_matches(word, words, n=1)
        return f"; it is `kingfisher {words[near[0]]}`" if near else ""

    def _in_our_words(self, message: str) -> str:
        """Return what is missing with what it is, where argparse only counts arguments; any other message as it is."""
        missing = message.removeprefix(_MISSING)
        if missing != message:
            named = {_placeholder(action): action for action in self._actions if not action.option_strings}
            return "; ".join(f"{name} is missing, give it: {_meaning(named.get(name))}" for name in missing.split(", "))
        unknown = _NO_CHOICE.fullmatch(message)
        if unknown is not None:
            action = next(
                one for one in self._actions if unknown[1] in ("/".join(one.option_strings), _placeholder(one))
            )
            allowed = [str(one) for one in action.choices or ()]
            near = meant(unknown[2], allowed) or self._sought(unknown[2])
            # A long list says less than one near word.
            return f"{unknown[1]} {unknown[2]}: there is none" + (near or f"; there are: {', '.join(allowed)}")
        valueless = _VALUELESS.fullmatch(message)
        if valueless is None:
            return message.removeprefix("argument ")
        option = next(
            (one for one in self._actions if valueless[1] in ("/".join(one.option_strings), _placeholder(one))), None
        )
        return f"{valueless[1]} {_placeholder(option)}: the value is missing; {_meaning(option)}"


def _placeholder(action: argparse.Action | None) -> str:
    """Return the word that stands for the value in ``--help``."""
    metavar = None if action is None else action.metavar
    if isinstance(metavar, str):
        return metavar
    return "VALUE" if action is None else action.dest.upper()


def _meaning(action: argparse.Action | None) -> str:
    """Return what a value is, as ``--help`` says it, or those that it may be."""
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
    for one in VERBS:
        if isinstance(one, Listed):
            commands.add_parser(one.name, description=one.text, listed=one)
            continue
        group = commands.add_parser(one.name, description=one.text, epilog=_exit_codes())
        inner = group.add_subparsers(required=True, metavar="VERB", parser_class=_Parser)
        for listed in one.verbs:
            inner.add_parser(listed.name, help=listed.text, description=listed.text, listed=listed)
    return top


class _Version(argparse.Action):
    def __call__(self, *_: object) -> NoReturn:
        from appliance.base import other_program

        say(f"kingfisher {__version__}")
        other = other_program()
        if other is not None:
            complain(other, as_json="--json" in sys.argv[1:])
        raise SystemExit(Exit.OK)


def _overview() -> str:
    """Return all verbs with a line each, under their headings."""
    lines = ["Handheld underwater 3D scanner. `kingfisher help VERB` says more of one."]
    named = {one.name: one for one in VERBS}
    for heading, names in SECTIONS.items():
        lines += ["", f"{heading}:"]
        for one in map(named.__getitem__, names):
            more = f" ({', '.join(verb.name for verb in one.verbs)})" if isinstance(one, Group) else ""
            lines.append(f"  {one.name:<12} {one.text}{more}")
    return "\n".join(lines)


def _exit_codes(*of: Exit) -> str:
    """Return the end of a help text: the codes that every verb may end with, and those ``of`` this one."""
    usual = (Exit.OK, Exit.FAILED, Exit.USAGE, *of, Exit.INTERRUPTED)
    return "exit codes: " + ", ".join(f"{code.value} {code.name.lower().replace('_', ' ')}" for code in usual)
