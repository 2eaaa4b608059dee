"""The diver's script: steps of a thread that knows the product only through its status file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from hw_sim.people import commands, status_file
from hw_sim.people.follower import follow
from hw_sim.people.operator import PRESS_S, Operator

if TYPE_CHECKING:
    from hw_sim.world import World

KEYS = ("scan", "back", "up", "down")
GRAMMAR = (
    f"allowed are: wait|never {'|'.join(status_file.CONDITIONS)} WORDS S, pause S, press KEY [S], follow MM S, end, "
    + ", ".join(" ".join(filter(None, (verb, arguments))) for verb, (arguments, _) in commands.HELP.items())
)


class ScriptError(Exception):
    """A step is invalid, or its condition was not met; the text has line and step."""

    exit_code = 2


@dataclass(frozen=True, slots=True)
class Step:
    """One line: its number, the verb and its arguments."""

    line: int
    verb: str
    arguments: tuple[str, ...]

    def __str__(self) -> str:
        return f"line {self.line}: {' '.join((self.verb, *self.arguments))}"


def read_script(path: Path) -> tuple[Step, ...]:
    """Read and parse a script's file. Raises ScriptError for an unreadable file."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ScriptError(f"script {path}: cannot be read ({error.strerror}); give a readable file") from error
    try:
        return parse_script(data.decode("utf-8"))
    except UnicodeDecodeError as error:
        raise ScriptError(f"script {path}: byte {error.start} is not UTF-8; a script is a text file") from error


def parse_script(text: str) -> tuple[Step, ...]:
    """Parse a script; every line is checked before the first is played. Raises ScriptError."""
    steps = []
    for number, raw in enumerate(text.splitlines(), 1):
        line_text = raw.split("#", 1)[0].strip()
        if not line_text:
            continue
        # A path is the remainder of its line, including blanks.
        tokens = line_text.split(maxsplit=1) if line_text.startswith("screenshot ") else line_text.split()
        step = Step(number, tokens[0], tuple(tokens[1:]))
        try:
            _check(step)
        except ValueError as error:
            raise ScriptError(f"{step}: {error}") from error
        steps.append(step)
    return tuple(steps)


def _check(step: Step) -> None:
    match step.verb, step.arguments:
        case (("wait" | "never"), (kind, first, *more, seconds)):
            _seconds(seconds)
            status_file.check(kind, [first, *more])
        case "pause", (seconds,):
            _seconds(seconds)
        case "press", (key, *hold) if len(hold) <= 1:
            if key not in KEYS:
                raise ValueError(f"key '{key}'; allowed are {', '.join(KEYS)}")
            for seconds in hold:
                _seconds(seconds)
        case "follow", (step_mm, seconds):
            _seconds(seconds)
            if not 0.0 < float(step_mm) <= 100.0:
                raise ValueError(f"a step of {step_mm} mm; allowed are 0..100")
        case "end", ():
            pass
        case _:
            if not commands.check(step.verb, step.arguments):
                raise ValueError(GRAMMAR)


def _seconds(word: str) -> float:
    seconds = float(word)
    if not 0 <= seconds < 1e6:
        raise ValueError(f"'{word}' is no duration in s; give a number")
    return seconds


class Diver(Operator):
    """Operates the instrument by a script."""

    def __init__(self, world: World, steps: tuple[Step, ...], status: Path) -> None:
        super().__init__(world, status)
        self._steps = steps

    def act(self) -> None:
        """Play step after step. Raises ScriptError."""
        for step in self._steps:
            try:
                self._play(step)
            except ScriptError:
                raise
            except Exception as error:
                raise ScriptError(f"{step}: {error}") from error
            if self.over:
                return

    def _play(self, step: Step) -> None:
        arguments = step.arguments
        match step.verb:
            case "wait":
                if not self._comes(arguments) and not self.over:
                    raise ScriptError(f"{step}: after {arguments[-1]} s {status_file.summary(self.status())}")
            case "never":
                if self._comes(arguments):
                    raise ScriptError(f"{step}: {status_file.summary(self.status())}")
            case "pause":
                self.sleep(float(arguments[0]))
            case "press":
                self.press(arguments[0], float(arguments[1]) if len(arguments) > 1 else PRESS_S)
            case "follow":
                if not follow(self, float(arguments[0]), float(arguments[1])) and not self.over:
                    raise ScriptError(f"{step}: after {arguments[1]} s the guidance is {self.status().get('guidance')}")
            case "end":
                if not self.switch_off() and not self.over:
                    raise ScriptError(f"{step}: the state is still {self.status().get('state')}")
            case _:
                commands.do(self.world, step.verb, arguments, self.status_path)

    def _comes(self, arguments: tuple[str, ...]) -> bool:
        """Return True if a condition is met in time.

        ``arguments``: kind, words of the condition, and the seconds.
        """
        kind, *what, seconds = arguments
        return self.until(lambda: status_file.is_met(self.status(), kind, what), float(seconds))
