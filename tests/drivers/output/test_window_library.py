"""What a window asks of the window library and of GL that a real screen does not show, over libraries of this test's own."""

from __future__ import annotations

import threading
import warnings
from typing import Any

import pytest

from drivers.api import DeviceRefused
from drivers.output import gl, window
from drivers.output.spec import OutputKind, OutputSpec
from drivers.output.window import Window
from tests.drivers.output.kernel import Time

SPEC = OutputSpec(OutputKind.WINDOW, None, None, 64, 48, 60.0)
EXACT = [0x0BD0, 0x809D, 0x8DB9]
"""Dithering, multisampling, sRGB: all are switched off, so that codes stay exact."""


class Place:
    """A uniform of a shader."""


class Screen:
    """A window library and its GL; what is not written out is noted."""

    Uniform = Place

    def __init__(self) -> None:
        self.log: list[tuple[Any, ...]] = []
        self.starts, self.gives = True, True
        self.reason: bytes | None = None

    def __getattr__(self, name: str) -> Any:
        return name if name.isupper() else lambda *said: self.log.append((name, *said))

    def init(self) -> bool:
        if not self.starts:
            warnings.warn("(65550) X11: the display cannot be opened", stacklevel=1)
        return self.starts

    def get_error(self) -> tuple[int, bytes | None]:
        return 1, self.reason

    def get_monitors(self) -> list[str]:
        return []

    def create_window(self, *_: Any) -> str | None:
        return "the window" if self.gives else None

    def create_context(self, **_: Any) -> Screen:
        if not self.gives:
            raise Exception("libEGL.so not found")
        return self

    def program(self, **_: str) -> dict[str, Place]:
        return {"place": Place()}

    def switched_off(self) -> list[int]:
        return sorted(said[1] for said in self.log if said[0] == "disable_direct")


@pytest.fixture
def screen(monkeypatch: pytest.MonkeyPatch) -> Screen:
    made = Screen()
    for module, name in ((window, "glfw"), (window, "moderngl"), (gl, "moderngl")):
        monkeypatch.setattr(module, name, made)
    return made


def test_codes_stay_exact_and_only_the_thread_that_made_the_window_handles_its_events(screen: Screen) -> None:
    made = Window("display", SPEC, Time())
    assert ("swap_interval", 1) in screen.log, "it waits for the blank"
    assert screen.switched_off() == EXACT
    screen.log.clear()
    other = threading.Thread(target=made.check_connection)
    other.start()
    other.join(10.0)
    assert ("poll_events",) not in screen.log
    with pytest.raises(KeyError), gl.open_gl():
        raise KeyError
    assert screen.log[-1] == ("release",), "an off-screen context is given back whatever happens"
    assert screen.switched_off() == EXACT


@pytest.mark.parametrize(
    ("starts", "reason", "said"),
    [
        (False, None, r"\(no display server\)"),
        (False, b"X11: not there", r"\(X11: not there\)"),
        (True, None, r"OpenGL 3\.3 \(no reason given\)"),
        (True, b"EGL: too old", r"OpenGL 3\.3 \(EGL: too old\)"),
    ],
)
def test_what_the_window_system_refuses_is_told_with_its_reason(
    screen: Screen, starts: bool, reason: bytes | None, said: str
) -> None:
    screen.starts, screen.gives, screen.reason = starts, False, reason
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # the library's own warning is told as our reason, and not beside it
        with pytest.raises(DeviceRefused, match=f"^display: .*{said}"):
            Window("display", SPEC, Time())
    with pytest.raises(DeviceRefused, match=r"libEGL\.so not found.*libegl1"):
        gl.open_gl().__enter__()
