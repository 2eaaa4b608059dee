"""One window: its images side by side, as large as the window allows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import glfw
import moderngl

from hw_sim.window.keyboard import HELP
from hw_sim.window.pictures import Picture

VERTEX = """
#version 330
out vec2 at;  // 0..1 from left to right and from top to bottom
void main() {
    vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1);
    at = vec2(corner.x, 1.0 - corner.y);
    gl_Position = vec4(2.0 * corner - 1.0, 0.0, 1.0);
}
"""
FRAGMENT = """
#version 330
uniform sampler2D picture;
in vec2 at;
out vec4 colour;
void main() { colour = vec4(texture(picture, at).rgb, 1.0); }
"""
Box = tuple[int, int, int, int]


@dataclass(frozen=True, slots=True)
class Layout:
    """A window: its title, its images, and the colours of each (as OpenGL's swizzles name them)."""

    title: str
    pictures: tuple[str, ...]
    colours: str
    size_px: tuple[int, int]
    place_px: tuple[int, int]


LAYOUTS = (
    Layout(f"Kingfisher: diver's display    {HELP}", ("display",), "RGB1", (800, 480), (20, 40)),
    Layout("Kingfisher: projector", ("projector",), "0R01", (512, 384), (840, 40)),  # its light is green
    Layout(
        "Kingfisher: left and right camera    hold and drag: move, right button: turn, wheel: nearer",
        ("left", "right"),
        "RRR1",
        (800, 300),
        (20, 570),
    ),
)


class Pane:
    """A window with a context of its own. Raises ValueError if the window system gives none."""

    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        self.handle: Any = glfw.create_window(*layout.size_px, layout.title, None, None)
        if not self.handle:
            raise ValueError(last_error() or "no reason given")
        glfw.set_window_pos(self.handle, *layout.place_px)
        glfw.make_context_current(self.handle)
        glfw.swap_interval(0)  # waiting for a blank in each of three windows would divide the rate by three
        try:
            self._context = moderngl.create_context(require=330, context=_FUNCTIONS_BY_GLFW)
        except Exception as error:  # the library raises nothing more particular
            raise ValueError(str(error)) from error
        program = self._context.program(vertex_shader=VERTEX, fragment_shader=FRAGMENT)
        self._square = self._context.vertex_array(program, [])
        self._textures: dict[str, moderngl.Texture] = {}
        self._drawn_px: tuple[int, int] | None = None

    def show(self, name: str, picture: Picture) -> None:
        """Take a new picture, (h, w, 3 or 1) uint8."""
        glfw.make_context_current(self.handle)
        height, width, channels = picture.shape
        texture = self._textures.get(name)
        if texture is None or texture.size != (width, height):
            if texture is not None:
                texture.release()
            texture = self._context.texture((width, height), channels, alignment=1)
            # One channel in red serves grey and green images alike: the swizzle moves it.
            texture.swizzle = self.layout.colours
            texture.repeat_x = texture.repeat_y = False
            self._textures[name] = texture
        texture.write(picture)
        self._drawn_px = None

    def draw(self) -> None:
        """Bring the window up to date, if it is not."""
        size_px = glfw.get_framebuffer_size(self.handle)
        if self._drawn_px == size_px:
            return
        glfw.make_context_current(self.handle)
        self._context.screen.use()
        self._context.viewport = (0, 0, *size_px)
        self._context.clear(0.1, 0.1, 0.1)
        for k, name in enumerate(self.layout.pictures):
            texture = self._textures.get(name)
            if texture is not None:
                self._context.viewport = fit(texture.size, size_px, k, len(self.layout.pictures))
                texture.use(0)
                self._square.render(moderngl.TRIANGLE_STRIP, vertices=4)
        glfw.swap_buffers(self.handle)
        self._drawn_px = size_px

    def spoil(self) -> None:
        """Draw anew next time, as the window system has lost the window's content."""
        self._drawn_px = None


def fit(picture_px: tuple[int, int], window_px: tuple[int, int], k: int, count: int) -> Box:
    """Return (left, bottom, width, height), px, of the ``k``-th of ``count`` images side by side, undistorted."""
    column = window_px[0] / count
    scale = min(column / picture_px[0], window_px[1] / picture_px[1])
    width, height = (max(1, round(scale * size)) for size in picture_px)
    return int(k * column + (column - width) / 2), (window_px[1] - height) // 2, width, height


def last_error() -> str:
    """Return the window library's text for its last failure."""
    message: Any = glfw.get_error()[1]  # bytes, although its type stub says str
    return message.decode("utf-8", "replace") if isinstance(message, bytes) else str(message or "")


class _FunctionsByGlfw:
    """Gives moderngl the GL functions of the current context."""

    def load_opengl_function(self, name: str) -> Any:
        return glfw.get_proc_address(name) or 0

    def release(self) -> None:
        pass


_FUNCTIONS_BY_GLFW: Any = _FunctionsByGlfw()
