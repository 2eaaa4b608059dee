"""Owns the diver's script: a list of steps, played by a thread that knows the product only through its status file."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2

from hw_sim.amounts import changed
from hw_sim.daylight import Daylight
from hw_sim.drift import Drift
from hw_sim.faults import parse
from hw_sim.knock import parse as parse_knock
from hw_sim.motion import Motion
from hw_sim.water import Water

if TYPE_CHECKING:
    from hw_sim.world import World

POLL_S = 0.05
SURROUNDINGS = {"motion": Motion(), "water": Water(), "daylight": Daylight(), "drift": Drift()}
"""What a step changes by its field of the scene."""
KEYS = ("scan", "back", "up", "down")
PRESS_S = 0.15
"""How long a key is held unless the step says so; also the diver's pause behind each press."""
POWER_OFF_HOLD_S = 1.2
POWER_OFF_TRIES = 15
POWER_OFF_TRY_S = 2.0
GRAMMAR = (
    "allowed are: wait state NAME S, wait alert CODE S, wait step NAME S, wait result NAME S, pause S, press KEY [S], "
    "fault SENTENCE, clear, object NAME [X Y Z RX RY RZ], knock CAMERA AMOUNTS, motion|water|daylight|drift AMOUNTS, "
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
        case ("wait", ("state" | "alert" | "step" | "result", _, seconds)) | ("pause", (seconds,)):
            _seconds(seconds)
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


class Diver:
    """Plays a script in a thread of its own. ``failure`` tells afterwards what did not happen."""

    def __init__(self, world: World, steps: tuple[Step, ...], status: Path) -> None:
        self._world = world
        self._steps = steps
        self._status = status
        self._stopped = False
        self.failure: str | None = None
        self.finished = False
        """The last step was played."""
        self._thread = threading.Thread(target=self._run, name="diver", daemon=True)

    def start(self) -> None:
        """Begin to play."""
        self._thread.start()

    def stop(self, grace_s: float) -> None:
        """Let the script come to its end for ``grace_s`` of real time, then end it. Raises RuntimeError if it hangs."""
        self._thread.join(grace_s)
        with self._world.time.condition:
            self._stopped = True
            self._world.time.condition.notify_all()
        self._thread.join(10.0)
        if self._thread.is_alive():
            raise RuntimeError("the diver's thread does not end")

    def _run(self) -> None:
        step = None
        try:
            for step in self._steps:
                self._play(step)
                if self._over:
                    break
            else:
                self.finished = True
        except ScriptError as error:
            self.failure = str(error)
            # Who waits for the diver must not wait for ever.
            self._switch_off()
        except Exception as error:
            self.failure = f"{step}: {error}"
            self._switch_off()

    @property
    def _over(self) -> bool:
        return self._stopped or self._world.time.closed

    def _play(self, step: Step) -> None:
        world, words = self._world, step.words
        match step.verb:
            case "wait":
                kind, name, seconds = words
                if not self._until(lambda: self._shows(kind, name), float(seconds)) and not self._over:
                    status = self._read()
                    codes = [alert.get("code") for alert in status.get("alerts", [])]
                    calibration = status.get("calibration")
                    raise ScriptError(
                        f"{step}: after {seconds} s the state is {status.get('state')}, alerts {codes}, "
                        f"calibration {calibration}"
                    )
            case "pause":
                self._sleep(float(words[0]))
            case "press":
                hold_s = float(words[1]) if len(words) > 1 else PRESS_S
                world.press(words[0], hold_s)
                self._sleep(hold_s + PRESS_S)
            case "fault":
                world.fault(" ".join(words))
            case "clear":
                world.clear_faults()
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
                if not self._switch_off() and not self._over:
                    raise ScriptError(f"{step}: the state is still {self._read().get('state')}")

    def _switch_off(self) -> bool:
        """The power-off gesture, again and again until the service shuts down."""
        for _ in range(POWER_OFF_TRIES):
            self._world.press("back", POWER_OFF_HOLD_S)
            if self._until(self._off, POWER_OFF_TRY_S):
                return True
            if self._over:
                break
        return False

    def _off(self) -> bool:
        """Switched off: the service says so, or has taken its status away."""
        return self._read().get("state") in (None, "SHUTDOWN")

    def _shows(self, kind: str, name: str) -> bool:
        status = self._read()
        if kind == "state":
            return status.get("state") == name
        if kind in ("step", "result"):  # of a calibration, when nothing is computed for it any more
            at = status.get("calibration") or {}
            return at.get(kind) == name and not at.get("busy")
        return any(alert.get("code") == name for alert in status.get("alerts", []))

    def _read(self) -> dict[str, Any]:
        try:
            content = json.loads(self._status.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return {}
        return content if isinstance(content, dict) else {}

    def _sleep(self, duration_s: float) -> None:
        with self._world.time.condition:
            self._world.time.wait_for(lambda: self._over, duration_s)

    def _until(self, predicate: Callable[[], bool], timeout_s: float) -> bool:
        end_ns = self._world.time_ns + int(timeout_s * 1e9)
        while not predicate():
            if self._over or self._world.time_ns > end_ns:
                return predicate()
            self._sleep(POLL_S)
        return True
