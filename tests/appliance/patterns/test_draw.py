"""What the projector gets is, code for code, what the decoder's arithmetic was made for."""

from __future__ import annotations

from collections.abc import Iterator

import moderngl
import numpy as np
import pytest

from appliance.patterns.draw import draw_patterns, draw_sequence
from appliance.patterns.response import Response
from appliance.patterns.sequence import Direction, build_sequence
from drivers.output.gl import open_gl


@pytest.fixture(scope="module")
def context() -> Iterator[moderngl.Context]:
    with open_gl() as gl:
        yield gl


@pytest.mark.parametrize(("period_px", "response"), [(16, None), (64, Response((0.45, 0.53, 0.05, -0.02)))])
def test_every_pixel_of_every_pattern_is_its_code(
    context: moderngl.Context, period_px: int, response: Response | None
) -> None:
    sequence = build_sequence(period_px)
    pictures = draw_sequence(context, sequence, response)
    assert len(pictures) == len(sequence)
    for pattern, picture in zip(sequence.patterns, pictures, strict=True):
        codes = pattern.codes(response)
        line = codes[np.newaxis, :] if pattern.direction is Direction.X else codes[:, np.newaxis]
        np.testing.assert_array_equal(picture, np.broadcast_to(line, (768, 1024)), err_msg=pattern.name)


@pytest.mark.parametrize(("width_px", "height_px"), [(256, 256), (61, 48)])
def test_every_code_survives_row_zero_is_the_top_and_no_width_is_sheared(
    context: moderngl.Context, width_px: int, height_px: int
) -> None:
    along = [np.arange(size, dtype=np.uint8)[::-1] for size in (width_px, height_px)]
    across, down = draw_patterns(context, [(Direction.X, along[0]), (Direction.Y, along[1])], width_px, height_px)
    np.testing.assert_array_equal(across, np.tile(along[0], (height_px, 1)), "memory of its own")
    np.testing.assert_array_equal(down, np.tile(along[1], (width_px, 1)).T)


def test_what_screens_have_set_in_the_shared_context_changes_no_code_and_stays_set(context: moderngl.Context) -> None:
    ramp = np.arange(256, dtype=np.uint8)
    with context:
        context.enable(moderngl.BLEND | moderngl.DEPTH_TEST)
        context.blend_func = moderngl.SRC_ALPHA, moderngl.ONE_MINUS_SRC_ALPHA
        target = context.simple_framebuffer((16, 16))
        target.use()
    (picture,) = draw_patterns(context, [(Direction.X, ramp)], 256, 4)
    np.testing.assert_array_equal(picture, np.tile(ramp, (4, 1)))
    with context:
        # Half of white over black is grey only while blending is on.
        program = context.program(
            vertex_shader="#version 330\nvoid main(){gl_Position=vec4((gl_VertexID%2)*4-1,(gl_VertexID/2)*4-1,0,1);}",
            fragment_shader="#version 330\nout vec4 c;void main(){c=vec4(1,1,1,0.5);}",
        )
        target.clear(0.0, 0.0, 0.0, 1.0)
        target.use()
        context.vertex_array(program, []).render(moderngl.TRIANGLES, vertices=3)
        assert abs(int(np.frombuffer(target.read(components=3), np.uint8)[0]) - 128) <= 1
        context.disable(moderngl.BLEND | moderngl.DEPTH_TEST)


def test_pictures_do_not_share_memory(context: moderngl.Context) -> None:
    black, white = np.zeros(8, np.uint8), np.full(8, 255, np.uint8)
    first, second = draw_patterns(context, [(Direction.X, black), (Direction.X, white)], 8, 8)
    assert (first.max(), second.min()) == (0, 255)


def test_a_table_of_the_wrong_length_is_named(context: moderngl.Context) -> None:
    with pytest.raises(ValueError, match=r"table 0 along y is \(1024,\) uint8; it must be \(768,\) uint8"):
        draw_patterns(context, [(Direction.Y, np.zeros(1024, np.uint8))], 1024, 768)
