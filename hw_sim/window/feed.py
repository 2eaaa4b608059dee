"""The world's side of the windows: it starts their process, sends it images, and applies the keys."""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

import hw_sim
from hw_sim.people.hands import Hands
from hw_sim.scene import Scene
from hw_sim.window.fingers import Fingers
from hw_sim.window.keyboard import HELP
from hw_sim.window.pictures import ROOMS, Picture, Pictures, Writer
from hw_sim.window.talk import Lines, format_sizes, say

LOG = logging.getLogger(__name__)
START_S = 30.0
"""Limit for the start of Python and a software renderer on a loaded machine."""
LOOK_S = 0.1
"""Interval at which the feed checks for its end."""
END_S = 5.0


class WindowError(Exception):
    """No window can be opened, or they have failed; the text has reason and remedy."""

    exit_code = 1


class ShownWorld(Protocol):
    """The part of a world that windows show and control."""

    @property
    def time_ns(self) -> int: ...

    def scanned_out(self, head: str) -> NDArray[np.uint8]: ...

    def seen(self, side: str) -> NDArray[np.uint8] | None: ...

    def touch(self, key: str, at_ns: int = 0) -> None: ...

    def let_go(self, key: str, at_ns: int = 0) -> None: ...

    @property
    def scene(self) -> Scene: ...

    @property
    def recording(self) -> bool: ...

    def set_scene(self, scene: Scene) -> None: ...


def interrupt() -> None:
    """Interrupt this process, like Ctrl-C in a terminal."""
    os.kill(os.getpid(), signal.SIGINT)


@contextmanager
def open_windows(world: ShownWorld, quit_wanted: Callable[[], None] = interrupt) -> Iterator[None]:
    """Windows of ``world`` and its keyboard, as long as the context lasts.

    ``quit_wanted`` is called, in another thread, when the user ends it, and when the windows have failed. Raises
    WindowError at once if no window can be opened, and at the end if they have failed.
    """
    pictures = Pictures.create()
    try:
        feed = Feed(world, pictures, quit_wanted)
        try:
            feed.start()
            yield
        finally:
            feed.close()
    finally:
        pictures.close()
    if feed.failure is not None:
        raise WindowError(feed.failure)


class Feed:
    """The process of the windows and the thread that communicates with it."""

    def __init__(self, world: ShownWorld, pictures: Pictures, quit_wanted: Callable[[], None]) -> None:
        self._world = world
        self._writer = Writer(pictures)
        self._quit_wanted = quit_wanted
        self._fingers = Fingers()
        self._hands = Hands(world)
        self._closing = False
        self.failure: str | None = None
        package = str(Path(hw_sim.__file__).parents[1])
        path = os.pathsep.join(filter(None, [package, os.environ.get("PYTHONPATH")]))
        self._process = subprocess.Popen(
            [sys.executable, "-m", "hw_sim.window", str(pictures.descriptor)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            pass_fds=(pictures.descriptor,),
            env={**os.environ, "PYTHONPATH": path, "EGL_LOG_LEVEL": "fatal"},
            process_group=0,  # a Ctrl-C is for the instrument; the windows end with it
        )
        assert self._process.stdin is not None and self._process.stdout is not None  # noqa: PT018
        self._to, self._from = self._process.stdin, Lines(self._process.stdout.fileno())
        self._thread = threading.Thread(target=self._run, name="windows", daemon=True)

    def start(self) -> None:
        """Wait until the windows are open. Raises WindowError."""
        word, _, text = (self._from.read(START_S) or "").partition(" ")
        if word == "failed":
            raise WindowError(text)
        if word != "open":
            raise WindowError(self._ended() if self._from.ended else f"the windows did not open within {START_S:g} s")
        LOG.info("windows are open; %s", HELP)
        self._thread.start()

    def close(self) -> None:
        """Close the windows and wait for the end of their process."""
        self._closing = True
        if self._thread.ident is not None:
            self._thread.join(END_S)
        self._to.close()
        try:
            self._process.wait(END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait(END_S)
        if self._process.stdout is not None:
            self._process.stdout.close()

    def _run(self) -> None:
        try:
            while not (self._closing or self._from.ended):
                line = self._from.read(LOOK_S)
                if line is not None:
                    self._heard(line)
                self._hands.settle(time.monotonic_ns())
        except Exception as error:
            self.failure = f"the windows: {error}"
        if self._from.ended and not self._closing:
            self.failure = self._ended()
        if self.failure is not None:
            self._quit_wanted()

    def _heard(self, line: str) -> None:
        match line.split():
            case ["want"]:
                say(self._to.fileno(), "show", *format_sizes(self._writer.write(self._pictures())))
            case [("down" | "up") as change, key, real_ns]:
                down = change == "down"
                at_ns = self._fingers.at(key, down, int(real_ns), self._world.time_ns)
                (self._world.touch if down else self._world.let_go)(key, at_ns)
            case ["shift", dx, dy, real_ns]:
                self._hands.shift(float(dx), float(dy), int(real_ns))
            case ["turn", dx, dy, real_ns]:
                self._hands.turn(float(dx), float(dy), int(real_ns))
            case ["wheel", notches, real_ns]:
                self._hands.wheel(float(notches), int(real_ns))
            case ["quit", *why]:
                LOG.info("%s", " ".join(why))
                self._quit_wanted()
            case _:
                raise ValueError(f"'{line}' is not understood")

    def _pictures(self) -> dict[str, Picture]:
        shown = {"display": self._world.scanned_out("display"), "projector": self._world.scanned_out("projector")}
        for side in ("left", "right"):
            image = self._world.seen(side)
            if image is not None:
                room = ROOMS[side]
                small = cv2.resize(image, (room.width_px, room.height_px), interpolation=cv2.INTER_AREA)
                shown[side] = np.asarray(small, np.uint8)
        return shown

    def _ended(self) -> str:
        try:
            code = self._process.wait(END_S)
        except subprocess.TimeoutExpired:
            return "the process of the windows has closed its connection"
        return f"the windows' process has ended with {code}; see its message above, or run again without --window"
