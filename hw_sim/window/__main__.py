"""The windows' process: it shows images, reports keyboard and mouse, and ends with its parent.

Its one argument is the descriptor of the images' memory; it talks over standard input and output (``talk.py``).
"""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Callable
from typing import Any

import glfw

from hw_sim.window.keyboard import MEANING, QUIT, Keyboard
from hw_sim.window.panes import LAYOUTS, Pane, last_error
from hw_sim.window.pictures import Pictures
from hw_sim.window.talk import Lines, parse_sizes, say

CAMERAS = ("left", "right")
TICK_S = 0.01
WANT_EVERY_NS = 33_000_000
NO_SERVER = "start it in a desktop session (with DISPLAY or WAYLAND_DISPLAY set), over ssh with -X, or under xvfb-run"
NO_GL = "OpenGL 3.3 over EGL is needed, by a graphics card or Mesa's software: install libegl1, libgl1, libgl1-mesa-dri"
NAMED = {
    glfw.KEY_ENTER: "enter",
    glfw.KEY_KP_ENTER: "enter",
    glfw.KEY_BACKSPACE: "backspace",
    glfw.KEY_UP: "up",
    glfw.KEY_DOWN: "down",
    glfw.KEY_ESCAPE: "escape",
}


def main(descriptor: int) -> int:
    """Show the windows until the parent closes standard input or one is closed; return the exit code."""
    try:
        panes = open_panes()
    except ValueError as error:
        say(1, "failed", f"window: cannot be opened ({error}); leave out --window to run without windows")
        return 1
    try:
        say(1, "open")
        WindowLoop(panes, Pictures(descriptor)).run()
    finally:
        glfw.terminate()
    return 0


def open_panes() -> list[Pane]:
    """Open all windows. Raises ValueError with the window system's reason, and a remedy."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the error has the same reason
        if not glfw.init():
            raise ValueError(f"{last_error() or 'no display server'}: {NO_SERVER}")
        for hint, value in (
            (glfw.CONTEXT_VERSION_MAJOR, 3),
            (glfw.CONTEXT_VERSION_MINOR, 3),
            (glfw.OPENGL_PROFILE, glfw.OPENGL_CORE_PROFILE),
            (glfw.CONTEXT_CREATION_API, glfw.EGL_CONTEXT_API),
        ):
            glfw.window_hint(hint, value)
        try:
            return [Pane(layout) for layout in LAYOUTS]
        except ValueError as error:
            raise ValueError(f"{error}: {NO_GL}") from error


class Mouse:
    """The mouse in the cameras' window: one button held shifts the instrument, the other rotates it."""

    def __init__(self, tell: Callable[..., None]) -> None:
        self._tell = tell
        self._held: str | None = None
        self._at: tuple[float, float] | None = None

    def button(self, _window: Any, button: int, action: int, _modifiers: int) -> None:
        held = {glfw.MOUSE_BUTTON_LEFT: "shift", glfw.MOUSE_BUTTON_RIGHT: "turn"}.get(button)
        self._held = held if action == glfw.PRESS else None

    def moved(self, _window: Any, x: float, y: float) -> None:
        before, self._at = self._at, (x, y)
        if self._held is not None and before is not None:
            self._tell(self._held, f"{x - before[0]:.2f}", f"{y - before[1]:.2f}", str(time.monotonic_ns()))

    def scrolled(self, _window: Any, _dx: float, dy: float) -> None:
        self._tell("wheel", f"{dy:.2f}", str(time.monotonic_ns()))


class WindowLoop:
    """The loop of the process."""

    def __init__(self, panes: list[Pane], pictures: Pictures) -> None:
        self._panes, self._pictures = panes, pictures
        self._keyboard = Keyboard()
        self._mouse = Mouse(self._tell)
        self._input = Lines(0)
        self._wanted = False
        self._over = False
        for pane in panes:
            glfw.set_key_callback(pane.handle, self._key)
            glfw.set_window_refresh_callback(pane.handle, self._spoiler(pane))
            if set(CAMERAS) & set(pane.layout.pictures):
                glfw.set_cursor_pos_callback(pane.handle, self._mouse.moved)
                glfw.set_mouse_button_callback(pane.handle, self._mouse.button)
                glfw.set_scroll_callback(pane.handle, self._mouse.scrolled)

    def run(self) -> None:
        next_ns = time.monotonic_ns()
        while not self._over:
            glfw.wait_events_timeout(TICK_S)
            for pane in self._panes:
                if glfw.window_should_close(pane.handle):
                    glfw.set_window_should_close(pane.handle, False)  # it stays until the instrument is off
                    self._tell(QUIT, "a window was closed")
            if not self._wanted and time.monotonic_ns() >= next_ns:
                next_ns = time.monotonic_ns() + WANT_EVERY_NS
                self._wanted = True
                self._tell("want")
            line = self._input.read(0.0)
            self._over |= self._input.ended
            if line is not None:
                self._show(parse_sizes(line.split()[1:]))
            for pane in self._panes:
                pane.draw()

    def _show(self, sizes: dict[str, tuple[int, int]]) -> None:
        self._wanted = False
        for pane in self._panes:
            for name in pane.layout.pictures:
                if name in sizes:
                    pane.show(name, self._pictures.view(name, *sizes[name]))

    def _key(self, _window: Any, code: int, scancode: int, action: int, _modifiers: int) -> None:
        real_ns = time.monotonic_ns()
        if action == glfw.REPEAT:
            return
        name = name_of(code, scancode)
        if MEANING.get(name) == QUIT and action == glfw.PRESS:
            self._tell(QUIT, f"{name} was pressed")
        change = self._keyboard.change(name, action == glfw.PRESS)
        if change is not None:
            self._tell("down" if change.down else "up", change.key, str(real_ns))

    def _tell(self, *message: str) -> None:
        self._over |= not say(1, *message)

    def _spoiler(self, pane: Pane) -> Callable[[Any], None]:
        return lambda _window: pane.spoil()


def name_of(code: int, scancode: int) -> str:
    """Return a letter of the layout (if it is not Latin: of a US keyboard), or the key's name."""
    if code in NAMED:
        return NAMED[code]
    letter = glfw.get_key_name(code, scancode) if code != glfw.KEY_UNKNOWN else None
    if letter is not None and letter.isascii():
        return str(letter).lower()
    return chr(code).lower() if glfw.KEY_A <= code <= glfw.KEY_Z else ""


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1])))
