"""Owns the diver's script: a list of steps, played by a thread that knows the product only through its status file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import cv2

from hw_sim import computer, sight
from hw_sim.actor import PRESS_S, Actor
from hw_sim.amounts import changed
from hw_sim.daylight import Daylight
from hw_sim.drift import Drift
from hw_sim.faults import parse
from hw_sim.knock import parse as parse_knock
from hw_sim.motion import Motion
from hw_sim.water import Water

if TYPE_CHECKING:
    from hw_sim.world import World

SURROUNDINGS = {"motion": Motion(), "water": Water(), "daylight": Daylight(), "drift": Drift()}
"""What a step changes by its field of the scene."""
KEYS = ("scan", "back", "up", "down")
GRAMMAR = (
    f"allowed are: wait|never {'|'.join(sight.SIGHTS)} WORDS S, pause S, press KEY [S], fault SENTENCE, clear, "
    "worker kill|hang, disk off|on, object NAME [X Y Z RX RY RZ], knock CAMERA AMOUNTS, motion|water|daylight|drift AMOUNTS, "
    "screenshot PATH, end"
)


class ScriptError(Exception):
    """A step is not understood, or what it waited for did not come; the text names line and step."""

    exit_code = 2


@dataclass(frozen=True, slots=True)
class Step:
    """One line: its number, the verb and its words."""

    line: int
    verb: str
    words: tuple[str, ...]

    def __str__(self) -> str:
        return f"line {self.line}: {' '.join((self.verb, *self.words))}"


def parse_script(text: str) -> tuple[Step, ...]:
    """Parse a script; every line is checked before the first is played. Raises ScriptError."""
    steps = []
    for number, raw in enumerate(text.splitlines(), 1):
        said = raw.split("#", 1)[0].strip()
        if not said:
            continue
        # A path is the rest of its line, blanks and all.
        words = said.split(maxsplit=1) if said.startswith("screenshot ") else said.split()
        step = Step(number, words[0], tuple(words[1:]))
        try:
            _check(step)
        except ValueError as error:
            raise ScriptError(f"{step}: {error}") from error
        steps.append(step)
    return tuple(steps)


def _check(step: Step) -> None:
    match step.verb, step.words:
        case (("wait" | "never"), (kind, first, *more, seconds)):
            _seconds(seconds)
            sight.check(kind, [first, *more])
        case "pause", (seconds,):
            _seconds(seconds)
        case (("worker" | "disk"), words):
            computer.check((step.verb, *words))
        case "press", (key, *hold) if len(hold) <= 1:
            if key not in KEYS:
                raise ValueError(f"key '{key}'; allowed are {', '.join(KEYS)}")
            for seconds in hold:
                _seconds(seconds)
        case "fault", (_, *_):
            parse(" ".join(step.words))
        case "object", (_, *pose) if len(pose) in (0, 6):
            [float(number) for number in pose]
        case "knock", (_, *_):
            parse_knock(" ".join(step.words))
        case verb, words if verb in SURROUNDINGS:
            changed(SURROUNDINGS[verb], verb, words)
        case ("screenshot", (_,)) | ("clear" | "end", ()):
            pass
        case _:
            raise ValueError(GRAMMAR)


def _seconds(word: str) -> float:
    seconds = float(word)
    if not 0 <= seconds < 1e6:
        raise ValueError(f"'{word}' is no duration in s")
    return seconds


class Diver(Actor):
    """Plays a script."""

    def __init__(self, world: World, steps: tuple[Step, ...], status: Path) -> None:
        super().__init__(world, status)
        self._steps = steps

    def act(self) -> None:
        """Step by step. Raises ScriptError."""
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
        world, words = self.world, step.words
        match step.verb:
            case "wait":
                if not self._sees(words) and not self.over:
                    raise ScriptError(f"{step}: after {words[-1]} s {sight.summary(self.status())}")
            case "never":
                if self._sees(words):
                    raise ScriptError(f"{step}: {sight.summary(self.status())}")
            case "pause":
                self.sleep(float(words[0]))
            case "press":
                self.press(words[0], float(words[1]) if len(words) > 1 else PRESS_S)
            case "fault":
                world.fault(" ".join(words))
            case "clear":
                world.clear_faults()
            case "worker" | "disk":
                computer.happen((step.verb, *words), self.status_path)
            case "object":
                world.set_object(words[0], [float(n) for n in words[1:]] or None)
            case "knock":
                world.knock(parse_knock(" ".join(words)))
            case verb if verb in SURROUNDINGS:
                world.set_scene(replace(world.scene, **{verb: changed(getattr(world.scene, verb), verb, words)}))
            case "screenshot":
                picture = world.scanned_out("display")
                if not cv2.imwrite(words[0], cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)):
                    raise ScriptError(f"{step}: the picture cannot be written")
            case _:
                if not self.switch_off() and not self.over:
                    raise ScriptError(f"{step}: the state is still {self.status().get('state')}")

    def _sees(self, words: tuple[str, ...]) -> bool:
        """Whether what the words say, or what they end with, comes to be seen in its time."""
        kind, *what, seconds = words
        return self.until(lambda: sight.sees(self.status(), kind, what), float(seconds))
