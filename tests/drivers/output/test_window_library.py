"""What a window asks of the window library and of GL, call by call, over libraries of this test's own."""

from __future__ import annotations

import threading
import warnings
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.api import DeviceGone, DeviceRefused
from drivers.output import gl, window
from drivers.output.spec import OutputKind, OutputSpec
from drivers.output.window import Window
from tests.drivers.output.kernel import Time

SPEC = OutputSpec(OutputKind.WINDOW, None, None, 64, 48, 60.0)
HANDLE = "the window"


class Uniform:
    """Of a shader."""

    value: object = None


class Screen:
    """A window library and its GL: both write into one log, so that their order shows."""

    def __init__(self) -> None:
        self.log: list[tuple[Any, ...]] = []
        self.hints: dict[str, Any] = {"DECORATED": "FALSE"}
        """With one that another window has left behind."""
        self.monitors: dict[str, str] = {}
        self.starts, self.gives, self.closing = True, True, False
        self.reason: bytes | None = None
        self.current: object = None
        self.size_px = (64, 48)
        self.place = Uniform()
        self.switched_off: list[int] = []
        self.TRIANGLES, self.Uniform = "triangles", Uniform
        self.screen = SimpleNamespace(use=lambda: self.note("screen"))

    def __getattr__(self, name: str) -> Any:
        if name.isupper():
            return name
        # What is not written out below is noted, with what it was called with.
        return lambda *said: self.note(name, *said)

    def __setattr__(self, name: str, value: object) -> None:
        if name == "viewport":
            self.note("viewport", value)
        object.__setattr__(self, name, value)

    def note(self, *said: Any) -> None:
        self.log.append(said)

    # ---- the window library

    def init(self) -> bool:
        if not self.starts:
            warnings.warn("(65550) X11: the display cannot be opened", stacklevel=1)
        return self.starts

    def get_error(self) -> tuple[int, bytes | None]:
        return 1, self.reason

    def default_window_hints(self) -> None:
        self.hints.clear()

    def window_hint(self, hint: str, value: Any) -> None:
        self.hints[hint] = value

    def get_monitors(self) -> list[str]:
        return list(self.monitors)

    def get_monitor_name(self, monitor: str) -> bytes:
        return self.monitors[monitor].encode()

    def get_video_mode(self, monitor: str) -> Any:
        return SimpleNamespace(size=SimpleNamespace(width=1920, height=1080))

    def create_window(self, width: int, height: int, title: str, monitor: Any, share: Any) -> str | None:
        self.note("window", width, height, title, monitor, share)
        return HANDLE if self.gives else None

    def make_context_current(self, handle: object) -> None:
        self.current = handle

    def get_framebuffer_size(self, handle: str) -> tuple[int, int]:
        return self.size_px

    def window_should_close(self, handle: str) -> bool:
        return self.closing

    def get_proc_address(self, name: str) -> int | None:
        return 4711 if name == "glFinish" else None

    # ---- GL

    def create_context(self, require: int, context: Any) -> Screen:
        assert (self.current, require) == (HANDLE, 330)
        assert (context.load_opengl_function("glFinish"), context.load_opengl_function("glNone")) == (4711, 0)
        return self

    def disable_direct(self, capability: int) -> None:
        self.switched_off.append(capability)

    def program(self, vertex_shader: str, fragment_shader: str) -> dict[str, Uniform]:
        assert "gl_VertexID" in vertex_shader
        assert "texelFetch" in fragment_shader
        return {"place": self.place}

    def vertex_array(self, program: Any, content: list[Any]) -> Any:
        assert (program, content) == ({"place": self.place}, [])
        return SimpleNamespace(render=lambda kind, vertices: self.note("render", kind, vertices))

    def texture(self, size: tuple[int, int], components: int, data: bytes, alignment: int) -> Any:
        assert (self.current, alignment) == (HANDLE, 1)
        self.note("texture", size, components, set(data), len(data))
        return SimpleNamespace(
            swizzle="", use=lambda unit: self.note("use", unit), write=lambda pixels: self.note("write", pixels.sum())
        )


@pytest.fixture
def screen(monkeypatch: pytest.MonkeyPatch) -> Screen:
    made = Screen()
    monkeypatch.setattr(window, "glfw", made)
    monkeypatch.setattr(window, "moderngl", made)
    return made


def opened(screen: Screen, spec: OutputSpec = SPEC) -> Window:
    made = Window("display", spec, Time())
    assert screen.current is None, "others may use theirs"
    return made


def test_a_window_has_a_fixed_size_gl_3_3_by_egl_and_waits_for_the_blank(screen: Screen) -> None:
    made = opened(screen)
    assert screen.log == [("window", 64, 48, "Kingfisher display", None, None), ("swap_interval", 1)]
    assert screen.hints == {
        "CONTEXT_VERSION_MAJOR": 3, "CONTEXT_VERSION_MINOR": 3, "OPENGL_PROFILE": "OPENGL_CORE_PROFILE",
        "CONTEXT_CREATION_API": "EGL_CONTEXT_API", "RESIZABLE": "FALSE", "SCALE_TO_MONITOR": "FALSE",
        "AUTO_ICONIFY": "FALSE",
    }  # fmt: skip
    assert (made.size_px, made.refresh_hz, made.device) == ((64, 48), 60.0, "display")
    assert made.describe()[0] == "window 64×48"
    assert sorted(screen.switched_off) == [0x0BD0, 0x809D, 0x8DB9], "dithering, multisampling, sRGB: codes stay exact"


@pytest.mark.parametrize(
    ("connector", "expected"),
    [
        ("EIZO", (1920, 1080, "Kingfisher display", "second", None)),
        ("none of these", (64, 48, "Kingfisher display", None, None)),
        (None, (64, 48, "Kingfisher display", None, None)),
    ],
)
def test_the_monitor_of_that_name_is_filled(screen: Screen, connector: str | None, expected: tuple[Any, ...]) -> None:
    screen.monitors = {"first": "Dell", "second": "EIZO"}
    opened(screen, OutputSpec(OutputKind.WINDOW, None, connector, 64, 48, 60.0))
    assert screen.log[0] == ("window", *expected)


def test_a_picture_begins_black_and_is_drawn_where_it_fits(screen: Screen) -> None:
    made = opened(screen)
    screen.log.clear()
    picture = made.create_picture()
    assert screen.log == [("texture", (64, 48), 4, {0}, 4 * 64 * 48)]
    assert picture.texture.swizzle == "BGR1"
    picture.write(np.ones((48, 64, 4), np.uint8))
    screen.log.clear()
    screen.size_px = (192, 100)
    shown = made.flip(picture, 1.0)
    assert screen.log == [
        *(("poll_events",), ("screen",), ("viewport", (0, 0, 192, 100)), ("use", 0), ("render", "triangles", 3)),
        *(("swap_buffers", HANDLE), ("finish",)),
    ]
    assert screen.place.value == (32, 2, 128, 96)
    assert (shown.sequence, shown.time_ns) == (None, Time().now_ns())
    assert screen.current is None


def test_only_the_thread_that_made_the_window_handles_its_events(screen: Screen) -> None:
    made = opened(screen)
    screen.log.clear()
    other = threading.Thread(target=made.check_connection)
    other.start()
    other.join(10.0)
    assert screen.log == []


def test_a_window_that_its_user_closes_is_gone_and_closing_it_again_does_nothing(screen: Screen) -> None:
    made = opened(screen)
    picture = made.create_picture()
    screen.closing = True
    with pytest.raises(DeviceGone, match="the window was closed"):
        made.flip(picture, 1.0)
    screen.closing = False
    screen.log.clear()
    made.close()
    made.close()
    assert screen.log == [("release",), ("destroy_window", HANDLE)]
    for use in (made.check_connection, made.create_picture):
        with pytest.raises(DeviceGone, match="the window was closed"):
            use()
    assert ("poll_events",) not in screen.log


@pytest.mark.parametrize(
    ("starts", "reason", "said"),
    [
        (False, None, r"no window can be opened \(no display server\)"),
        (False, b"X11: not there", r"no window can be opened \(X11: not there\)"),
        (True, None, r"gave no window with OpenGL 3\.3 \(no reason given\)"),
        (True, b"EGL: too old", r"gave no window with OpenGL 3\.3 \(EGL: too old\)"),
    ],
)
def test_what_the_window_system_refuses_is_told_with_its_reason(
    screen: Screen, starts: bool, reason: bytes | None, said: str
) -> None:
    screen.starts, screen.gives, screen.reason = starts, False, reason
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # the library's own warning is told as our reason, and not beside it
        with pytest.raises(DeviceRefused, match=said) as caught:
            opened(screen)
    assert caught.value.device == "display"


def test_an_off_screen_context_is_exact_and_given_back_whatever_happens(monkeypatch: pytest.MonkeyPatch) -> None:
    made = Screen()
    made.current = HANDLE
    asked: list[dict[str, Any]] = []

    def create(**wanted: Any) -> Screen:
        asked.append(wanted)
        return made

    monkeypatch.setattr(gl, "moderngl", SimpleNamespace(create_context=create))
    with pytest.raises(KeyError), gl.open_gl():
        raise KeyError
    assert made.log == [("release",)]
    assert sorted(made.switched_off) == [0x0BD0, 0x809D, 0x8DB9]
    assert asked == [{"require": 330, "standalone": True, "backend": "egl"}]


def test_without_a_driver_for_gl_it_is_said_which_packages_are_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(**wanted: Any) -> Any:
        raise Exception("libEGL.so not found")

    monkeypatch.setattr(gl, "moderngl", SimpleNamespace(create_context=missing))
    with pytest.raises(DeviceRefused, match=r"no OpenGL 3\.3 context by EGL \(libEGL\.so not found\)\. Install"):
        gl.open_gl().__enter__()
