"""Somebody at a simulated bench who reads what the guide asks for on stderr, does it in the world, and presses Enter."""

from __future__ import annotations

import io
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from types import TracebackType
from typing import Self

import pytest

from appliance.cli import main
from hw_sim.world import World

PRESSED_AFTER_S = 0.05


@dataclass
class Builder:
    """What the person does at a ``DO:``. ``hands``: by a piece of the wish, what is done; an answer of False presses no Enter."""

    world: World
    hands: dict[str, Callable[[], bool | None]] = field(default_factory=dict)
    asked: list[str] = field(default_factory=list)
    stderr: str = ""
    _timers: list[threading.Timer] = field(default_factory=list)

    def act(self, line: str) -> bool:
        """Do what a line asks for; True where Enter is to be pressed."""
        self.asked.append(line)
        for piece, hand in self.hands.items():
            if piece in line:
                return hand() is not False and "press Enter" in line
        if "press" in line and "let it go" in line:
            key = line.split()[2].lower()
            timer = threading.Timer(PRESSED_AFTER_S, self.world.press, (key, 0.15))
            timer.start()
            self._timers.append(timer)
        elif "caps on both" in line:
            self.world.set_scene(replace(self.world.scene, ambient=0.0))
        return "press Enter" in line

    def rest(self) -> None:
        for timer in self._timers:
            timer.join(5.0)


class _Heard(io.TextIOBase):
    """Stderr as the builder reads it."""

    def __init__(self, builder: Builder, answers: int) -> None:
        self._builder, self._answers = builder, answers

    def write(self, text: str) -> int:
        self._builder.stderr += text
        if text.startswith("DO: ") and self._builder.act(text.strip()):
            os.write(self._answers, b"\n")
        return len(text)

    def isatty(self) -> bool:
        return False

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        return None


@contextmanager
def at_the_bench(builder: Builder, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Inside: stderr is read by the builder, and stdin has what he answers."""
    read, write = os.pipe()
    with monkeypatch.context() as patched, os.fdopen(read) as answers:
        patched.setattr("sys.stderr", _Heard(builder, write))
        patched.setattr("sys.stdin", answers)
        try:
            yield
        finally:
            os.close(write)
            builder.rest()


def guided(builder: Builder, monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    """Run ``kingfisher bringup guide`` with these arguments at the builder's bench; the exit code."""
    with at_the_bench(builder, monkeypatch):
        return main(["bringup", "guide", *arguments])
