"""Owns the diver's script: a list of steps, played by a thread that knows the product only through its status file."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2

from hw_sim.faults import parse

if TYPE_CHECKING:
    from hw_sim.world import World

POLL_S = 0.05
KEYS = ("scan", "back", "up", "down")
POWER_OFF_HOLD_S = 1.2
POWER_OFF_TIMEOUT_S = 30.0


class ScriptError(Exception):
    """A step is not understood, or what it waited for did not come; the text names line and step."""


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
        words = raw.split("#", 1)[0].split()
        if not words:
            continue
        step = Step(number, words[0], tuple(words[1:]))
        try:
            _check(step)
        except (ValueError, IndexError) as error:
            raise ScriptError(f"{step}: {error}") from error
        steps.append(step)
    return tuple(steps)


def _check(step: Step) -> None:
    match step.verb, step.words:
        case "wait", ("state", _, seconds):
            float(seconds)
        case "wait", ("alert", _, seconds):
            float(seconds)
        case "pause", (seconds,):
            float(seconds)
        case "press", (key, *hold):
            if key not in KEYS:
                raise ValueError(f"key '{key}'; allowed are {', '.join(KEYS)}")
            if hold:
                float(hold[0])
        case "fault", (_, *_):
            parse(" ".join(step.words))
        case "object", (_, *pose):
            if len(pose) not in (0, 6):
                raise ValueError("a pose has six numbers: x y z rx ry rz")
            [float(number) for number in pose]
        case "screenshot", (_,):
            pass
        case (("clear" | "end"), ()):
            pass
        case _:
            raise ValueError(
                "allowed are: wait state NAME S, wait alert CODE S, pause S, press KEY [S], fault SENTENCE, clear, "
                "object NAME [POSE], screenshot PATH, end"
            )


class Diver:
    """Plays a script in a thread of its own, ``sim-diver``. ``error`` tells afterwards what did not happen."""

    def __init__(self, world: World, steps: tuple[Step, ...], status: Path) -> None:
        self._world = world
        self._steps = steps
        self._status = status
        self.error: ScriptError | None = None
        self._thread = threading.Thread(target=self._run, name="sim-diver", daemon=True)

    @property
    def running(self) -> bool:
        """The script has not come to its end."""
        return self._thread.is_alive()

    def start(self) -> None:
        """Begin to play."""
        self._thread.start()

    def join(self, timeout_s: float) -> None:
        """Wait for the end, in real time."""
        self._thread.join(timeout_s)

    def _run(self) -> None:
        try:
            for step in self._steps:
                self._play(step)
        except ScriptError as error:
            self.error = error
            if self._read().get("state") not in (None, "SHUTDOWN"):
                self._switch_off()

    def _play(self, step: Step) -> None:
        world, words = self._world, step.words
        match step.verb:
            case "wait":
                kind, name, seconds = words
                if not self._until(lambda: self._shows(kind, name), float(seconds)):
                    status = self._read()
                    codes = [alert.get("code") for alert in status.get("alerts", [])]
                    raise ScriptError(f"{step}: after {seconds} s the state is {status.get('state')}, alerts {codes}")
            case "pause":
                world.time.sleep_s(float(words[0]))
            case "press":
                world.press(words[0], float(words[1]) if len(words) > 1 else 0.15)
                world.time.sleep_s(0.3)
            case "fault":
                world.fault(" ".join(words))
            case "clear":
                world.clear_faults()
            case "object":
                world.set_object(words[0], [float(n) for n in words[1:]] or None)
            case "screenshot":
                picture = world.scanned_out("display")
                if not cv2.imwrite(words[0], cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)):
                    raise ScriptError(f"{step}: the picture cannot be written")
            case _:
                self._switch_off()

    def _switch_off(self) -> None:
        for _ in range(int(POWER_OFF_TIMEOUT_S / 2)):
            self._world.press("back", POWER_OFF_HOLD_S)
            if self._until(self._off, 2.0) or self._world.time.closed:
                return

    def _off(self) -> bool:
        """Switched off: the service says so, or has taken its status away."""
        return self._read().get("state") in (None, "SHUTDOWN")

    def _shows(self, kind: str, name: str) -> bool:
        status = self._read()
        if kind == "state":
            return status.get("state") == name
        return any(alert.get("code") == name for alert in status.get("alerts", []))

    def _read(self) -> dict[str, Any]:
        try:
            content = json.loads(self._status.read_text())
        except (OSError, ValueError):
            return {}
        return content if isinstance(content, dict) else {}

    def _until(self, predicate: Callable[[], bool], timeout_s: float) -> bool:
        end_ns = self._world.time_ns + int(timeout_s * 1e9)
        while not predicate():
            if self._world.time.closed or self._world.time_ns > end_ns:
                return predicate()
            self._world.time.sleep_s(POLL_S)
        return True
