"""An output that is a window on a desk: the same pictures, without the instrument's hardware."""

from __future__ import annotations

import contextlib
import threading
import warnings
from collections.abc import Iterator, Mapping
from typing import Any, TypeVar

import glfw
import moderngl
import numpy as np
from numpy.typing import NDArray

from drivers.api import Clock, DeviceGone, DeviceRefused
from drivers.output.gl import make_exact
from drivers.output.pacing import Pacer
from drivers.output.spec import OutputSpec
from drivers.output.surface import FlipStamp

_T = TypeVar("_T")
_VERTEX = """
#version 330
void main() {  // one triangle that covers the window
    gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0);
}
"""
_FRAGMENT = """
#version 330
uniform sampler2D picture;
uniform ivec4 place;  // left, bottom, width, height of the picture in the window
out vec4 colour;
void main() {
    ivec2 size = textureSize(picture, 0);
    ivec2 at = (ivec2(gl_FragCoord.xy) - place.xy) * size / place.zw;
    at.y = size.y - 1 - at.y;  // pictures count rows from the top
    bool inside = all(greaterThanEqual(ivec2(gl_FragCoord.xy), place.xy)) && all(lessThan(at, size)) && at.y >= 0;
    colour = inside ? vec4(texelFetch(picture, at, 0).rgb, 1.0) : vec4(0.0, 0.0, 0.0, 1.0);
}
"""


class WindowPicture:
    """A texture of one window's context."""

    def __init__(self, window: Window, texture: moderngl.Texture) -> None:
        self._window = window
        self.texture = texture

    def write(self, pixels: NDArray[np.uint8]) -> None:
        with self._window.current():
            self.texture.write(pixels)


class Window:
    """A window of the wanted size, or, where ``connector`` names a monitor, that monitor in full.

    To be opened and presented to by the main thread, which also handles the window's events; a projector may be played
    from another one. It has no counter of vertical blanks. Raises DeviceRefused without a display server.
    """

    def __init__(self, device: str, spec: OutputSpec, clock: Clock) -> None:
        self.device = device
        self.size_px = (spec.width_px, spec.height_px)
        self.refresh_hz = spec.refresh_hz
        self._clock = clock
        self._pacer = Pacer(clock, spec.refresh_hz)
        self._thread = threading.get_ident()
        self._handle: Any = _create(device, spec)
        with self.current():
            glfw.swap_interval(1)
            self._context = moderngl.create_context(require=330, **_FUNCTIONS_BY_GLFW)
            make_exact(self._context)
            program = self._context.program(vertex_shader=_VERTEX, fragment_shader=_FRAGMENT)
            self._place = _member(program, "place", moderngl.Uniform)
            self._triangle = self._context.vertex_array(program, [])

    @contextlib.contextmanager
    def current(self) -> Iterator[None]:
        """Make the window's context current in this thread within the block, and release it afterwards."""
        if self._handle is None:
            raise DeviceGone(self.device, "the window was closed", "Start again to reopen it")
        glfw.make_context_current(self._handle)
        try:
            yield
        finally:
            glfw.make_context_current(_NO_WINDOW)

    def create_picture(self) -> WindowPicture:
        width, height = self.size_px
        with self.current():
            texture = self._context.texture((width, height), 4, bytes(4 * width * height), alignment=1)
            texture.swizzle = "BGR1"
        return WindowPicture(self, texture)

    def flip(self, picture: WindowPicture, timeout_s: float) -> FlipStamp:
        """Show a picture like ``Surface.flip``.

        ``timeout_s`` cannot be kept by a window system and is not used.
        """
        self.check_connection()
        self._pacer.wait()
        with self.current():
            across, down = glfw.get_framebuffer_size(self._handle)
            self._context.screen.use()
            self._context.viewport = (0, 0, across, down)
            self._place.value = fit(self.size_px, (across, down))
            picture.texture.use(0)
            self._triangle.render(moderngl.TRIANGLES, vertices=3)
            glfw.swap_buffers(self._handle)
            self._context.finish()
            time_ns = self._clock.now_ns()
        self._pacer.shown(time_ns)
        return FlipStamp(None, time_ns)

    def check_connection(self) -> None:
        """Handle the window's events. Raises DeviceGone when its user closed it."""
        if self._handle is not None and threading.get_ident() == self._thread:
            glfw.poll_events()  # only the thread that made the windows may do this
        if self._handle is None or glfw.window_should_close(self._handle):
            raise DeviceGone(self.device, "the window was closed", "Start again to reopen it")

    def describe(self) -> tuple[str, Mapping[str, str]]:
        width, height = self.size_px
        return f"window {width}×{height}", {"flips": "timed by the window system, not by vertical blanks"}

    def close(self) -> None:
        if self._handle is not None:
            with self.current():
                self._context.release()
            glfw.destroy_window(self._handle)
            self._handle = None


def fit(picture_px: tuple[int, int], window_px: tuple[int, int]) -> tuple[int, int, int, int]:
    """Return (left, bottom, width, height) of the picture in the window: whole, centred, undistorted.

    A window at least as large shows whole multiples of pixels, so that every pattern stripe keeps its width.
    """
    scale = min(window_px[0] / picture_px[0], window_px[1] / picture_px[1])
    if scale >= 1.0:
        scale = float(int(scale))
    width, height = (max(1, round(scale * size)) for size in picture_px)
    return (window_px[0] - width) // 2, (window_px[1] - height) // 2, width, height


class _GlfwLoader:
    """Gives moderngl the addresses of GL functions in the window's context."""

    def load_opengl_function(self, name: str) -> Any:
        return glfw.get_proc_address(name) or 0

    def release(self) -> None:
        pass


_FUNCTIONS_BY_GLFW: dict[str, Any] = {"context": _GlfwLoader()}
_NO_WINDOW: Any = None


def _member(program: moderngl.Program, name: str, kind: type[_T]) -> _T:
    member = program[name]
    if not isinstance(member, kind):
        raise TypeError(f"shader member {name} is {type(member).__name__}, not {kind.__name__}")
    return member


def _text(value: Any) -> str:
    """Return text of the library, which has bytes where its type stubs say str, and None for no text."""
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value or "")


def _create(device: str, spec: OutputSpec) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the error below says it better
        started = glfw.init()
    if not started:
        raise DeviceRefused(
            device,
            f"no window can be opened ({_text(glfw.get_error()[1]) or 'no display server'})",
            "Set kind to kms, or start under X11 or Wayland (DISPLAY, WAYLAND_DISPLAY)",
        )
    glfw.default_window_hints()
    for hint, value in (
        (glfw.CONTEXT_VERSION_MAJOR, 3),
        (glfw.CONTEXT_VERSION_MINOR, 3),
        (glfw.OPENGL_PROFILE, glfw.OPENGL_CORE_PROFILE),
        # The painter's context is EGL, too; GLX and EGL cannot take turns in one thread.
        (glfw.CONTEXT_CREATION_API, glfw.EGL_CONTEXT_API),
        (glfw.RESIZABLE, glfw.FALSE),
        (glfw.SCALE_TO_MONITOR, glfw.FALSE),
        (glfw.AUTO_ICONIFY, glfw.FALSE),
    ):
        glfw.window_hint(hint, value)
    monitors = {_text(glfw.get_monitor_name(monitor)): monitor for monitor in glfw.get_monitors()}
    monitor = monitors.get(spec.connector or "")
    width, height = spec.width_px, spec.height_px
    if monitor is not None:
        now = glfw.get_video_mode(monitor)
        width, height = now.size.width, now.size.height
    handle = glfw.create_window(width, height, f"Kingfisher {device}", monitor, None)
    if not handle:
        raise DeviceRefused(
            device,
            f"the window system gave no window with OpenGL 3.3 ({_text(glfw.get_error()[1]) or 'no reason given'})",
            "Install a graphics driver with OpenGL 3.3 and EGL",
        )
    return handle
