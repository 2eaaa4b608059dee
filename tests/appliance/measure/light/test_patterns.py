"""What the projector gets: the paper's sequence, a sine of light, and code for code what the decoder's arithmetic was made for."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import moderngl
import numpy as np
import pytest
from numpy.polynomial import chebyshev

from appliance.measure.light.draw import draw_patterns, draw_sequence
from appliance.measure.light.patterns import (
    PERIODS_PX,
    STEP_ORDERS,
    Direction,
    Kind,
    Pattern,
    PatternSequence,
    build_sequence,
    inverse_gray,
)
from appliance.measure.light.response import Response, phase_error_rad
from drivers.output.gl import open_gl

FRAMES = {(16, 1024, 768): 24, (32, 1024, 768): 22, (64, 1024, 768): 20, (21, 1024, 768): 24, (16, 1280, 720): 25, (64, 1280, 720): 21}  # fmt: skip


@pytest.mark.parametrize("steps", STEP_ORDERS)
@pytest.mark.parametrize("made", FRAMES)
def test_neighbours_differ_in_one_image_and_codes_and_phase_give_back_every_pixel(
    made: tuple[int, int, int], steps: tuple[int, ...]
) -> None:
    """Lengths are those of the paper; 1280 × 720, as DLP3010: 160 and 90 half periods of 16 px need 8 and 7 bits."""
    sequence, period_px = build_sequence(*made, steps=steps), made[0]
    assert len(sequence) == FRAMES[made]
    for axis in map(sequence.axis, Direction):
        lit = np.array([sequence.patterns[i].codes() > 128 for i in axis.gray]).astype(np.int64)
        half = 2 * np.arange(axis.size_px) // period_px
        assert (np.abs(np.diff(lit, axis=1)).sum(axis=0) == np.diff(half)).all()
        code = (lit << np.arange(len(lit))[::-1, None]).sum(axis=0)
        np.testing.assert_array_equal(inverse_gray(len(lit))[code], half)
        i0, i1, i2, i3 = (sequence.patterns[i].codes().astype(float) for i in axis.sine)
        turn = np.arctan2(i3 - i1, i0 - i2) / (2 * np.pi) % 1.0
        p = period_px * (np.rint((half + 0.5) / 2 - turn) + turn) - 0.5
        np.testing.assert_allclose(p, np.arange(axis.size_px), atol=0.005 * period_px)


def test_steps_of_each_period_are_whole_pixels_and_one_out_of_range_names_itself_and_the_range() -> None:
    """No pattern is a copy of two."""
    assert [period_px % 4 for period_px in PERIODS_PX] == [0, 0, 0]
    with pytest.raises(ValueError, match=r"fringe period 3 px; allowed are 4\.\.768 px"):
        build_sequence(3)


P = list(build_sequence(64).patterns)
"""Bright, dark, 5 + 4 of X, 5 + 4 of Y."""


@pytest.mark.parametrize(
    ("patterns", "said"),
    [
        ([*P[:8], P[9], P[8], *P[10:]], r"frame 8 .* sine-x-270 .*; sine-x-90 .* belongs there"),
        (P[:10] + P[11:], r"frame 10 .* gray-y-0 .*; sine-x-180"),
        ([*P[:11], replace(P[10], index=4), *P[11:]], r"frame 11 .* sine-x-360 .*; gray-y-0"),
        (P[:11], r"frame 11 .* nothing; gray-y-0"),
        (P[:2] + P[11:] + P[2:11], r"frame 2 .* gray-y-0 .*; gray-x-0"),
        (P[:2] + P[6:1:-1] + P[7:], r"frame 2 .* gray-x-4 .*; gray-x-0"),
        (P[:2] + P[7:11] + P[2:7] + P[11:], r"frame 2 .* sine-x-0 .*; gray-x-0"),
        ([P[0], *P[2:]], r"frame 1 .* gray-x-0 .*; dark"),
        ([P[0], *P[2:], P[1]], r"frame 1 .* gray-x-0 .*; dark"),
        ([*P[:9], replace(P[9], period_px=32), *P[10:]], r"frame 9 .* sine-x-270 \(1024 px, period 32 px\); sine-x-270 \(1024"),
        ([*P[:16], replace(P[16], size_px=1024), *P[17:]], r"frame 16 .* sine-y-0 \(1024 px, .*; sine-y-0 \(768 px"),
        ([*P[:18], P[19], P[18]], r"frame 18 .* sine-y-180 .*; sine-y-270"),
        ([*P, P[-1]], r"frame 20 .* sine-y-180 .*; nothing belongs there"),
    ],
)  # fmt: skip
def test_a_sequence_that_breaks_what_its_judges_rely_on_cannot_be_made(patterns: list[Pattern], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        PatternSequence(64, 1024, 768, tuple(patterns))


def test_sequences_that_are_equal_are_one_key_and_the_frames_of_an_axis_are_those_that_vary_along_it() -> None:
    for period_px, width_px, height_px in ((16, 1024, 768), (64, 1024, 768), (12, 400, 300)):
        one = build_sequence(period_px, width_px, height_px)
        bright, dark, *rest = one.patterns
        other = PatternSequence(period_px, width_px, height_px, (dark, bright, *rest))
        assert len({one, build_sequence(period_px, width_px, height_px), other}) == 2
        assert (other.bright, other.dark) == (1, 0)
        for axis in map(one.axis, Direction):
            named = {k: one.patterns[k] for k in (*axis.gray, *axis.sine)}
            assert {p.direction for p in named.values()} == {axis.direction}
            assert [named[k].kind for k in sorted(named)] == [Kind.GRAY] * len(axis.gray) + [Kind.SINE] * 4
            assert sum(p.direction is axis.direction for p in rest) == len(named)


def test_sine_and_cosine_of_our_order_have_one_middle_and_those_of_the_rising_one_are_a_frame_apart() -> None:
    for steps, pair_frames, apart in ((STEP_ORDERS[0], (3, 1), 0), (STEP_ORDERS[1], (2, 2), 1)):
        sequence = build_sequence(32, steps=steps)
        assert sequence.steps == steps
        for axis in map(sequence.axis, Direction):
            zero, quarter, half, three = axis.sine
            assert (axis.pair_frames, (quarter + three - zero - half) // 2) == (pair_frames, apart)
            assert (axis.last, axis.last - axis.gray[-1]) == (max(axis.sine), 4)
    assert build_sequence(32).steps == (0, 1, 3, 2)


@pytest.mark.parametrize("steps", STEP_ORDERS)
def test_a_sequence_is_found_again_by_the_names_of_its_patterns(steps: tuple[int, ...]) -> None:
    one = build_sequence(16, 400, 300, steps=steps)
    for patterns in (one.patterns, (one.patterns[1], one.patterns[0], *one.patterns[2:])):
        kept = PatternSequence(16, 400, 300, patterns)
        assert PatternSequence.of_names(16, 400, 300, tuple(p.name for p in patterns)) == kept
    with pytest.raises(
        ValueError, match=r"patterns bright, .*: no sequence of 16 px on 400 × 300; allowed are bright, dark"
    ):
        PatternSequence.of_names(16, 400, 300, tuple(p.name for p in one.patterns[:-1]))


X = np.linspace(-1.0, 1.0, 2001)


def light_of(codes: np.ndarray) -> np.ndarray:
    """A projector with toe and shoulder, by a formula of its own."""
    x = codes.astype(float) / 255.0
    return 0.3 * x**1.2 + 0.7 * (3 * x**2 - 2 * x**3)


def response() -> Response:
    fitted = chebyshev.chebfit(X, light_of(127.5 + 119.5 * X), 12)
    return Response(tuple(float(b) for b in fitted))


def harmonic(light: np.ndarray, order: int) -> float:
    phase = 2 * np.pi * (np.arange(light.size) + 0.5) / 64
    return float(2 * np.mean(light * np.cos(order * phase)))


def test_light_is_a_sine_where_codes_were_one_before() -> None:
    sequence = build_sequence(64)
    sine = sequence.patterns[sequence.axis(sequence.patterns[-1].direction).sine[0]]
    before, after = light_of(sine.codes()), light_of(sine.codes(response()))
    for order in (2, 3):
        assert abs(harmonic(before, order)) > 0.01 or order == 2
        assert abs(harmonic(after, order)) < 0.002 * harmonic(after, 1)
    assert abs(harmonic(before, 3)) > 0.05 * harmonic(before, 1)
    assert after.max() == pytest.approx(before.max(), abs=0.005), "no contrast is given away"
    assert after.min() == pytest.approx(before.min(), abs=0.005)


def test_the_phase_error_of_harmonics_is_what_four_steps_make_of_them() -> None:
    b = (0.5, 0.45, 0.06, -0.03, 0.01, 0.008)
    phi = np.linspace(0, 2 * np.pi, 5000)
    i0, i1, i2, i3 = (sum(a * np.cos(k * (phi + step * np.pi / 2)) for k, a in enumerate(b)) for step in range(4))
    error = np.angle(np.exp(1j * (np.arctan2(i3 - i1, i0 - i2) - phi)))
    assert phase_error_rad(b) == pytest.approx(np.abs(error).max(), rel=1e-3)
    assert phase_error_rad((0.5, 0.45, 0.2, 0.0, 0.1)) < 1e-12, "even harmonics cancel"


def test_only_sine_images_change_and_what_no_projector_does_is_refused() -> None:
    for pattern in build_sequence(16).patterns:
        same = (pattern.codes() == pattern.codes(response())).all()
        assert same == (pattern.kind is not Kind.SINE), pattern.name
    for harmonics in ((0.5,), (0.5, -0.5), (0.5, 0.5, 0.5), (0.5, float("nan")), (0.1,) * 30):
        with pytest.raises(ValueError, match="measure it again"):
            Response(harmonics)


@pytest.fixture(scope="module")
def context() -> Iterator[moderngl.Context]:
    with open_gl() as gl:
        yield gl


def test_every_pixel_of_every_pattern_is_its_code(context: moderngl.Context) -> None:
    for period_px, response in ((16, None), (64, Response((0.45, 0.53, 0.05, -0.02)))):
        sequence = build_sequence(period_px)
        for pattern, picture in zip(sequence.patterns, draw_sequence(context, sequence, response), strict=True):
            codes = pattern.codes(response)
            line = codes[np.newaxis, :] if pattern.direction is Direction.X else codes[:, np.newaxis]
            np.testing.assert_array_equal(picture, np.broadcast_to(line, (768, 1024)), err_msg=pattern.name)


def test_every_code_survives_row_zero_is_the_top_and_no_width_is_sheared(context: moderngl.Context) -> None:
    for width_px, height_px in ((256, 256), (61, 48)):
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


def test_a_table_of_the_wrong_length_is_named(context: moderngl.Context) -> None:
    with pytest.raises(ValueError, match=r"table 0 along y is \(1024,\) uint8; it must be \(768,\) uint8"):
        draw_patterns(context, [(Direction.Y, np.zeros(1024, np.uint8))], 1024, 768)
