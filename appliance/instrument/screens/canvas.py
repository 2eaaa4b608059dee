"""Drawing on a picture: boxes, text and images in pixels of the design, from the top left.

Each drawing is one quad. Row 0 of the frame buffer is the top row of the picture, so that it is read back upright.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

import cv2
import moderngl
import numpy as np
from numpy.typing import NDArray

from appliance.instrument.machine.words import Label, Language, worded
from appliance.instrument.screens.theme import BODY, BOLD, CAPTION, DESIGN_SIZE_PX, WHITE, Colour, colour_table
from drivers.api import DeviceGone

MAX_TEXTS = 192
"""Largest number of text textures kept; the least recently used is released first."""

_QUAD = """
#version 330
uniform vec2 size;
uniform vec4 box;  // left, top, width, height in pixels
out vec2 inside;   // pixels from the box's top left corner
void main() {
    vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1);
    inside = corner * box.zw;
    gl_Position = vec4((box.xy + inside) / size * 2.0 - 1.0, 0.0, 1.0);
}
"""
_BOX = """
#version 330
uniform vec4 box;
uniform vec4 fill;
uniform vec4 edge;
uniform float edge_width;
uniform vec4 radii;  // top left, top right, bottom right, bottom left
in vec2 inside;
out vec4 colour;
void main() {
    vec2 half_size = 0.5 * box.zw;
    vec2 p = inside - half_size;
    float r = p.x < 0.0 ? (p.y < 0.0 ? radii.x : radii.w) : (p.y < 0.0 ? radii.y : radii.z);
    vec2 q = abs(p) - half_size + r;
    float distance = min(max(q.x, q.y), 0.0) + length(max(q, 0.0)) - r;  // negative inside
    vec4 paint = mix(edge, fill, edge_width > 0.0 ? clamp(0.5 - (distance + edge_width), 0.0, 1.0) : 1.0);
    colour = vec4(paint.rgb, paint.a * clamp(0.5 - distance, 0.0, 1.0));
}
"""
_ARROW = """
#version 330
uniform vec4 box;
uniform vec4 fill;
uniform vec4 edge;
uniform float edge_width;
uniform vec2 toward;  // of length 1
in vec2 inside;
out vec4 colour;
void main() {
    vec2 p = inside - 0.5 * box.zw;
    p = vec2(dot(p, toward), abs(p.y * toward.x - p.x * toward.y));  // along and beside
    float s = box.z;
    vec2 shaft = abs(p - vec2(-0.20 * s, 0.0)) - vec2(0.26 * s, 0.12 * s);
    float head = max(-p.x, 0.64 * (p.x - 0.46 * s) + 0.77 * p.y);  // a flank's normal has length 1
    float distance = min(max(shaft.x, shaft.y), head);  // negative inside
    vec4 paint = mix(edge, fill, clamp(0.5 - (distance + edge_width), 0.0, 1.0));
    colour = vec4(paint.rgb, paint.a * clamp(0.5 - distance, 0.0, 1.0));
}
"""
_WORDS = """
#version 330
uniform sampler2D mask;
uniform vec4 fill;
in vec2 inside;
out vec4 colour;
void main() {
    colour = vec4(fill.rgb, fill.a * texelFetch(mask, ivec2(inside), 0).r);
}
"""
_IMAGE = """
#version 330
uniform sampler2D image;
uniform vec4 box;
uniform float radius;
uniform bool grey_only;
in vec2 inside;
out vec4 colour;
void main() {
    vec4 texel = texture(image, inside / box.zw);
    vec3 paint = grey_only ? texel.rrr : texel.rgb;
    // Stripes where the camera is saturated: visible in colour, in grey, and to who cannot tell yellow from white.
    bool stripe = grey_only && texel.r > 0.975 && mod(inside.x + inside.y, 10.0) < 4.0;
    vec2 q = abs(inside - 0.5 * box.zw) - 0.5 * box.zw + radius;
    float distance = min(max(q.x, q.y), 0.0) + length(max(q, 0.0)) - radius;
    colour = vec4(stripe ? vec3(0.05) : paint, clamp(0.5 - distance, 0.0, 1.0));
}
"""
_WATER = """
#version 330
uniform vec4 box;
uniform float phase;
uniform float centre;  // of the round thing, as a fraction of the width
in vec2 inside;
out vec4 colour;
void main() {  // fringes bent by something round, fading out downwards
    vec2 p = inside / box.zw;
    vec2 from_centre = (inside - box.zw * vec2(centre, 1.05)) / box.w;
    float height = sqrt(max(0.0, 0.64 - dot(from_centre, from_centre)));
    float fringe = 0.5 + 0.5 * cos(0.26 * inside.x + 11.0 * height - phase);
    float light = pow(fringe, 1.6) * (0.10 + 0.55 * smoothstep(0.0, 0.45, height));
    vec3 tint = mix(vec3(0.02, 0.10, 0.14), vec3(0.25, 0.82, 0.91), light);
    colour = vec4(tint * (0.35 + 0.65 * light), 1.0);
}
"""
_BAR = """
#version 330
uniform sampler2D colours;
uniform vec4 box;
in vec2 inside;
out vec4 colour;
void main() {
    vec2 q = abs(inside - 0.5 * box.zw) - 0.5 * box.zw + 0.5 * box.w;
    float distance = length(max(q, 0.0)) - 0.5 * box.w;
    colour = vec4(texture(colours, vec2(1.0 - inside.x / box.z, 0.5)).rgb, clamp(0.5 - distance, 0.0, 1.0));
}
"""


@dataclass(frozen=True, slots=True)
class TextLine:
    """One line of text on the picture; lengths in units of the design, of the ink only."""

    text: str
    left: float
    top: float
    right: float
    bottom: float
    size: int
    """Size of the type after it was reduced to fit."""
    colour: Colour
    cut: bool
    """True if it did not fit even at the smallest size, and ends in an ellipsis."""


class Align(Enum):
    LEFT = 0.0
    CENTRE = 0.5
    RIGHT = 1.0


@dataclass(frozen=True, slots=True)
class _TextTexture:
    texture: moderngl.Texture
    width_px: int
    height_px: int
    baseline_px: int
    ink_px: tuple[int, int, int, int]
    """Left, top, right, bottom of the letters within the texture."""


class Canvas:
    """A picture of ``size_px``, drawn in units of the design size and read back once."""

    def __init__(self, context: moderngl.Context, size_px: tuple[int, int]) -> None:
        self.context = context
        self.language = Language.ENGLISH
        """Language of the text."""
        self.size_px = size_px
        # The smaller of both, so that the design fits on a display of any shape.
        self.scale = min(size_px[0] / DESIGN_SIZE_PX[0], size_px[1] / DESIGN_SIZE_PX[1])
        self.width, self.height = size_px[0] / self.scale, size_px[1] / self.scale
        self._resources: list[Any] = []
        target = self._keep(context.renderbuffer(size_px, 4))
        self.framebuffer = self._keep(context.framebuffer([target]))
        self._picture = np.empty((size_px[1], size_px[0], 3), np.uint8)
        self._box, self._box_quad = self._program(_BOX)
        self._arrow, self._arrow_quad = self._program(_ARROW)
        self._letters, self._letters_quad = self._program(_WORDS)
        self._image, self._image_quad = self._program(_IMAGE)
        self._water, self._water_quad = self._program(_WATER)
        self._bar, self._bar_quad = self._program(_BAR)
        self._table = self._keep(context.texture((256, 1), 3, colour_table(), alignment=1))
        # OpenCV's own variable font, so that the width of text does not depend on fonts of the system.
        self._font = cv2.FontFace("sans")
        self._texts: OrderedDict[tuple[str, int, int], _TextTexture] = OrderedDict()
        self._images: dict[str, moderngl.Texture] = {}
        self.written: list[TextLine] = []
        """Every line of text since ``begin``, for checks of size, contrast and space."""
        self.pictured: list[tuple[str, float, float, float, float]] = []
        """Every image since ``begin``: its slot, and left, top, right, bottom in units of the design."""

    def begin(self, background: Colour) -> None:
        self.written.clear()
        self.pictured.clear()
        # An earlier user of the context may have left an error, as by releasing a bound object.
        _ = self.context.error
        self.framebuffer.use()
        self.context.viewport = (0, 0, *self.size_px)
        self.context.disable(moderngl.DEPTH_TEST)
        self.context.enable(moderngl.BLEND)
        self.context.blend_func = moderngl.SRC_ALPHA, moderngl.ONE_MINUS_SRC_ALPHA
        self.framebuffer.clear(*background.as_tuple())

    def finish(self) -> NDArray[np.uint8]:
        """Return the picture (height, width, 3) uint8 RGB, in the same memory each time.

        Raises DeviceGone without a context.
        """
        self.framebuffer.read_into(self._picture, components=3, alignment=1)
        # Checked once for each picture: reading it back has completed all drawing.
        error = self.context.error
        if error != "GL_NO_ERROR":
            raise DeviceGone("gl", f"drawing failed ({error})", "Restart the service")
        return self._picture

    def box(
        self,
        left: float,
        top: float,
        width: float,
        height: float,
        fill: Colour,
        radius: float | Sequence[float] = 0.0,
        edge: tuple[Colour, float] | None = None,
    ) -> None:
        """Draw a box, rounded by ``radius`` (all corners, or top left, top right, bottom right, bottom left).

        ``edge``: colour and width of a line around it.
        """
        edge_colour, edge_width = edge or (fill, 0.0)
        radii = [radius] * 4 if isinstance(radius, int | float) else list(radius)
        program = self._box
        program["fill"] = fill.as_tuple()
        program["edge"] = edge_colour.as_tuple()
        program["edge_width"] = edge_width * self.scale
        program["radii"] = tuple(r * self.scale for r in radii)
        self._place(program, left, top, width, height)
        self._box_quad.render(moderngl.TRIANGLE_STRIP, vertices=4)

    def arrow(
        self,
        x: float,
        y: float,
        size: float,
        toward: tuple[float, float],
        fill: Colour,
        edge: Colour,
        edge_width: float,
    ) -> None:
        """Draw an arrow around (x, y), ``size`` long, that points ``toward`` right and down (of length 1)."""
        program = self._arrow
        program["fill"] = fill.as_tuple()
        program["edge"] = edge.as_tuple()
        program["edge_width"] = edge_width * self.scale
        program["toward"] = toward
        self._place(program, x - size / 2, y - size / 2, size, size)
        self._arrow_quad.render(moderngl.TRIANGLE_STRIP, vertices=4)

    def write(
        self,
        text: Label,
        origin: tuple[float, float],
        size: int = BODY,
        weight: int = BOLD,
        colour: Colour = WHITE,
        align: Align = Align.LEFT,
        max_width: float | None = None,
    ) -> float:
        """Write one line of text at a place on its baseline; return its width.

        It is smaller if it would be wider than ``max_width``, but not smaller than a caption, the smallest readable
        size: longer text is cut.
        """
        text = self.translate(text)
        if not text:
            return 0.0
        x, baseline = origin
        cut = False
        if max_width is not None:
            width = self.measure(text, size, weight)
            if width > max_width:
                # A good guess first, since each measured size is drawn and kept as a texture. Widths are not quite
                # proportional to sizes.
                size = max(CAPTION, int(size * max_width / width))
                while size > CAPTION and self.measure(text, size, weight) > max_width:
                    size -= 1
            full_text = text
            while self.measure(text, size, weight) > max_width and len(text) > 1:
                text = text.removesuffix("…")[:-1].rstrip() + "…"
            cut = text != full_text
        line = self._line(text, round(size * self.scale), weight)
        # Integer pixels, for which the letters were anti-aliased.
        left = round(x * self.scale - align.value * line.width_px)
        top = round(baseline * self.scale) - line.baseline_px
        from_left, from_top, to_right, to_bottom = (edge / self.scale for edge in line.ink_px)
        x, y = left / self.scale, top / self.scale
        ends = TextLine(text, x + from_left, y + from_top, x + to_right, y + to_bottom, size, colour, cut)
        self.written.append(ends)
        self._stamp(line, left, top, colour)
        return line.width_px / self.scale

    def _stamp(self, line: _TextTexture, left_px: int, top_px: int, colour: Colour) -> None:
        line.texture.use(0)
        self._letters["fill"] = colour.as_tuple()
        self._letters["size"] = self.size_px
        self._letters["box"] = (left_px, top_px, line.width_px, line.height_px)
        self._letters_quad.render(moderngl.TRIANGLE_STRIP, vertices=4)

    def translate(self, label: Label) -> str:
        """Return a label as text in the canvas's language."""
        return worded(label, self.language)

    def measure(self, label: Label, size: int = BODY, weight: int = BOLD) -> float:
        """Return the width of a line of text."""
        return self._line(self.translate(label), round(size * self.scale), weight).width_px / self.scale

    def image(self, slot: str, pixels: NDArray[np.uint8], left: float, top: float, width: float, height: float) -> None:
        """Draw an image in the middle of the box, as large as fits.

        ``pixels``: (h, w) uint8 of a camera, with stripes where saturated, or (h, w, 3) uint8 RGB. ``slot`` names its
        texture, which is used again.
        """
        shape = pixels.shape[1] / pixels.shape[0]
        if width / height > shape:  # the picture keeps its shape
            left, width = left + (width - height * shape) / 2, height * shape
        else:
            top, height = top + (height - width / shape) / 2, width / shape
        self.pictured.append((slot, left, top, left + width, top + height))
        across, down = max(1, round(width * self.scale)), max(1, round(height * self.scale))
        # Averaged on the processor: GL would sample only some of the pixels, with moiré in fine texture.
        shrink = pixels.shape[0] > down or pixels.shape[1] > across
        if shrink:
            pixels = np.asarray(cv2.resize(pixels, (across, down), interpolation=cv2.INTER_AREA), np.uint8)
        size, components = (pixels.shape[1], pixels.shape[0]), 1 if pixels.ndim == 2 else 3
        texture = self._images.get(slot)
        if texture is None or texture.size != size or texture.components != components:
            if texture is not None:
                texture.release()
            texture = self._images[slot] = self.context.texture(size, components, alignment=1)
            texture.repeat_x = texture.repeat_y = False
        # GL needs contiguous rows; an image may be a view into a wider array.
        texture.write(np.ascontiguousarray(pixels))
        texture.use(0)
        self._image["radius"] = 10.0 * self.scale
        self._image["grey_only"] = components == 1
        self._place(self._image, left, top, width, height)
        self._image_quad.render(moderngl.TRIANGLE_STRIP, vertices=4)

    def water(self, left: float, top: float, width: float, height: float, phase: float, centre: float = 0.5) -> None:
        """Draw fringes on a round object, as an ornament."""
        self._water["phase"] = phase
        self._water["centre"] = centre
        self._place(self._water, left, top, width, height)
        self._water_quad.render(moderngl.TRIANGLE_STRIP, vertices=4)

    def colours(self, left: float, top: float, width: float, height: float) -> None:
        """Draw the colour table of clouds as a horizontal bar, its bright end on the left."""
        self._table.use(0)
        self._place(self._bar, left, top, width, height)
        self._bar_quad.render(moderngl.TRIANGLE_STRIP, vertices=4)

    def pixels(self, left: float, top: float, width: float, height: float) -> tuple[int, int, int, int]:
        """Return a box of the design in pixels of the picture: left, top, width, height."""
        s = self.scale
        return round(left * s), round(top * s), round(width * s), round(height * s)

    def close(self) -> None:
        """Release every GL object."""
        for line in self._texts.values():
            line.texture.release()
        for texture in self._images.values():
            texture.release()
        for resource in reversed(self._resources):
            resource.release()
        self._texts.clear()
        self._images.clear()
        self._resources.clear()

    def _line(self, text: str, size_px: int, weight: int) -> _TextTexture:
        key = (text, size_px, weight)
        if key in self._texts:
            self._texts.move_to_end(key)
            return self._texts[key]
        _, _, width, _ = cv2.getTextSize((0, 0), text, (0, 0), self._font, size_px, weight)
        # 1.4 type sizes include the dots of Ä and the descenders; the rest is for anti-aliasing.
        width_px, height_px, baseline_px = int(width) + 4, round(1.4 * size_px) + 2, size_px + 1
        mask = np.zeros((height_px, width_px), np.uint8)
        # The image is wider than the text, otherwise the library would wrap its last letter.
        wide = np.zeros((height_px, width_px + 2 * size_px), np.uint8)
        cv2.putText(wide, text, (1, baseline_px), (255,), self._font, size_px, weight)
        mask[:] = wide[:, :width_px]
        texture = self.context.texture((width_px, height_px), 1, mask, alignment=1)
        columns, rows = np.flatnonzero(mask.any(axis=0)), np.flatnonzero(mask.any(axis=1))
        ink_px = (int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1) if columns.size else (0,) * 4
        line = self._texts[key] = _TextTexture(texture, width_px, height_px, baseline_px, ink_px)
        if len(self._texts) > MAX_TEXTS:
            _, oldest = self._texts.popitem(last=False)
            oldest.texture.release()
        return line

    def _place(self, program: moderngl.Program, left: float, top: float, width: float, height: float) -> None:
        program["size"] = self.size_px
        program["box"] = tuple(float(value) for value in self.pixels(left, top, width, height))

    def _program(self, fragment_shader: str) -> tuple[moderngl.Program, moderngl.VertexArray]:
        program = self._keep(self.context.program(vertex_shader=_QUAD, fragment_shader=fragment_shader))
        return program, self._keep(self.context.vertex_array(program, []))

    def _keep(self, resource: Any) -> Any:
        self._resources.append(resource)
        return resource
