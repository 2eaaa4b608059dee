"""Drawing of patterns: a table of codes, spread over columns or rows by a shader, exact to the bit."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence

import moderngl
import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.patterns import Direction, PatternSequence
from appliance.measure.light.response import Response

_VERTEX = """
#version 330
void main() {  // one triangle that covers the picture
    gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0);
}
"""
_FRAGMENT = """
#version 330
uniform sampler2D codes;  // one row of 8-bit codes
uniform bool along_rows;
out float code;
void main() {
    // texelFetch neither filters nor rounds. Row 0 of the frame buffer is the first row that is read back, and is
    // drawn as the top row of the pattern: nothing has to be turned over.
    ivec2 at = ivec2(gl_FragCoord.xy);
    code = texelFetch(codes, ivec2(along_rows ? at.y : at.x, 0), 0).r;
}
"""


def draw_patterns(
    context: moderngl.Context,
    tables: Sequence[tuple[Direction, NDArray[np.uint8]]],
    width_px: int,
    height_px: int,
) -> list[NDArray[np.uint8]]:
    """Draw each table of codes as an image (height_px, width_px) uint8, row 0 at the top.

    It is exact to the bit. A table (n,) uint8 varies along ``Direction.X`` (n = width_px) or ``Direction.Y`` (n =
    height_px). The results are copies. Raises ValueError for a table of another length.
    """
    for number, (direction, table) in enumerate(tables):
        size = width_px if direction is Direction.X else height_px
        if table.shape != (size,) or table.dtype != np.uint8:
            raise ValueError(
                f"table {number} along {direction.value} is {table.shape} {table.dtype}; it must be ({size},) uint8"
            )
    pictures = [np.empty((height_px, width_px), np.uint8) for _ in tables]
    with context, contextlib.ExitStack() as resources:
        target = context.renderbuffer((width_px, height_px), 1)
        resources.callback(target.release)
        canvas = context.framebuffer([target])
        resources.callback(canvas.release)
        program = context.program(vertex_shader=_VERTEX, fragment_shader=_FRAGMENT)
        resources.callback(program.release)
        triangle = context.vertex_array(program, [])
        resources.callback(triangle.release)
        codes = {
            Direction.X: context.texture((width_px, 1), 1, alignment=1),
            Direction.Y: context.texture((height_px, 1), 1, alignment=1),
        }
        for texture in codes.values():
            resources.callback(texture.release)
        dither = 0x0BD0
        context.disable_direct(dither)  # on by default in GL; it would change codes
        # Screens share the context and use blending, which would change a code.
        with context.scope(canvas, enable_only=moderngl.NOTHING):
            for (direction, table), picture in zip(tables, pictures, strict=True):
                codes[direction].write(np.ascontiguousarray(table))
                codes[direction].use(0)
                program["along_rows"] = direction is Direction.Y
                triangle.render(moderngl.TRIANGLES, vertices=3)
                canvas.read_into(picture, components=1, alignment=1)
    return pictures


def draw_sequence(
    context: moderngl.Context, sequence: PatternSequence, response: Response | None = None
) -> list[NDArray[np.uint8]]:
    """Return every pattern of a sequence in order, (height, width) uint8, for a projector's ``response``."""
    tables = [(pattern.direction, pattern.codes(response)) for pattern in sequence.patterns]
    return draw_patterns(context, tables, sequence.width_px, sequence.height_px)
