"""The bring-up's judgements by themselves: a flash, its windows and sub-frames, grey, lines, and edits of a rig file."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.measure.light.exposure import Exposure
from appliance.store.config import default_rig_path, parse_rig
from appliance.workshop import light
from appliance.workshop.finding import BringupError
from appliance.workshop.latency import latency_of
from appliance.workshop.light import LightTiming, Trial, best_offer, promising_trials, timing_of, trials, windows_of
from appliance.workshop.plane import CoordinateRipple, next_exposure, ripple_of, smooth_plane
from appliance.workshop.raster import LINES, compare_lines
from appliance.workshop.response import Shape, judge_response, ramp_codes
from appliance.workshop.rig_edit import KeyValue, with_keys

PERIOD_US = 1e6 / 60.0
PACKAGED = default_rig_path().read_text(encoding="utf-8")
CODES = ramp_codes(62).astype(np.float64)


def slices(*windows_us: tuple[float, float], count: int = 200) -> NDArray[np.float64]:
    """Return a profile of a lamp of 10 grey values a slice, on in these windows."""
    edges = 250.0 * np.arange(count + 1)
    lit = [np.clip(np.minimum(edges[1:], end) - np.maximum(edges[:-1], begin), 0.0, None) for begin, end in windows_us]
    return np.asarray(10.0 * np.sum(lit, axis=0) / 250.0, np.float64)


@pytest.mark.parametrize("at", [0, 5])
def test_the_first_lit_frame_is_the_latency(at: int) -> None:
    levels = np.full(24, 2.0)
    levels[at] = 150.0
    found = [latency_of(levels)]
    for next_dn in (80.0, 2.0 + 148.0 * 0.02):  # the light goes on beyond a blank
        levels[at + 1] = next_dn
        found.append(latency_of(levels))
    levels += np.tile([0.3, -0.3, 0.0], 8)  # noise is no flash
    found.append(latency_of(levels))
    levels[at : at + 2] = 6.0, 2.0  # nor is it beside a faint one
    assert [*found, latency_of(levels)] == [at] * 5


def test_a_flash_that_is_none_or_too_long_is_refused() -> None:
    levels = np.full(24, 2.0)
    with pytest.raises(BringupError, match="3 are needed"):
        latency_of(levels)
    levels[1:5] = 100.0
    with pytest.raises(BringupError, match="lit 4 frames in a row; allowed are 2"):
        latency_of(levels)


@pytest.mark.parametrize("begin", [0.0, 130.0])
def test_a_window_is_found_to_a_part_of_a_slice(begin: float) -> None:
    (window,) = windows_of(slices((begin, begin + 6_333.0)))
    assert window.begins_us == pytest.approx(begin, abs=60.0)
    assert window.ends_us == pytest.approx(begin + 6_333.0, abs=60.0)
    first, second = windows_of(slices((begin, begin + 3_000.0), (begin + 4_000.0, begin + 6_000.0)))
    assert second.begins_us - first.ends_us == pytest.approx(1_000.0, abs=100.0)


def test_light_shortly_before_a_blank_belongs_to_it() -> None:
    early = timing_of(slices((PERIOD_US - 300.0, 2 * PERIOD_US - 900.0)), PERIOD_US)
    assert early.latency_blanks == 1
    assert early.begins_us == pytest.approx(-300.0, abs=60.0)
    late = timing_of(slices((PERIOD_US - 2_000.0, 2 * PERIOD_US - 2_500.0)), PERIOD_US)
    assert (late.latency_blanks, late.overhangs(PERIOD_US)) == (0, True)
    assert not early.overhangs(PERIOD_US)
    with pytest.raises(BringupError, match="no light in any time slice"):
        timing_of(np.zeros(200), PERIOD_US)


@pytest.mark.parametrize("count", [2, 3])
def test_equal_parts_of_a_frame_are_counted(count: int) -> None:
    step = PERIOD_US / count

    def lit(late_us: float = 0.0) -> list[NDArray[np.float64]]:
        begins = [k * step + 500.0 + late_us * (k == count - 1) for k in range(count)]
        return [slices(*((begin, begin + length) for begin in begins)) for length in (3_000.0, 1_700.0)]

    def counted(*bits: NDArray[np.float64]) -> int:
        return light.sub_frames_of(list(bits), 0.0, PERIOD_US)

    bits, steady = lit(), slices((0.0, PERIOD_US))
    # The same course, a fifth dimmer in the first part and brighter in the last: what is between is as bright as the mean.
    lights = np.ones(200)
    lights[: int(step / 250.0)], lights[int((count - 1) * step / 250.0) + 1 :] = 0.8, 1.2
    assert counted(*bits) == counted(*bits, steady) == count, "steady light repeats with any number, and says nothing"
    for unequal in (
        [*bits, slices((500.0, 2_500.0))],
        [bit * lights for bit in bits],
        lit(1_000.0),
        [steady],
        [np.zeros(200)],
    ):
        assert counted(*unequal) == 1


def grey(curve: NDArray[np.float64], noise: float = 0.0, seed: int = 1) -> NDArray[np.float64]:
    return 2.0 + 150.0 * (curve + noise * np.random.default_rng(seed).standard_normal(len(curve)))


STRAIGHT = CODES / 255.0
FALLS = np.where(np.arange(len(CODES)) == 30, STRAIGHT[29], STRAIGHT)


@pytest.mark.parametrize(
    ("curve", "shape"),
    [
        (STRAIGHT, Shape.STRAIGHT), (STRAIGHT**1.1, Shape.CURVED), (STRAIGHT**2.2, Shape.GAMMA), (STRAIGHT**0.45, Shape.GAMMA),
        (STRAIGHT + 0.05 * (CODES >= 128), Shape.BIT_PLANES), (STRAIGHT - 0.02 * (CODES % 32 >= 16), Shape.BIT_PLANES),
        (np.sin(0.6 * np.pi * STRAIGHT), Shape.BIT_PLANES),
    ],
)  # fmt: skip
def test_grey_is_straight_curved_gamma_or_cut(curve: NDArray[np.float64], shape: Shape) -> None:
    first, second = grey(curve, 0.001, 1), grey(curve, 0.001, 2)
    found = judge_response(CODES, first, second)
    assert (found.shape, found.usable) == (shape, shape in (Shape.STRAIGHT, Shape.CURVED))
    backwards = np.argsort(-CODES)
    again = judge_response(CODES[backwards], first[backwards], second[backwards])
    assert again.shape is shape, "in whatever order the codes were shown"


@pytest.mark.parametrize(
    ("first", "second", "shape"),
    [
        (grey(STRAIGHT, 0.02, 1), grey(STRAIGHT, 0.02, 2), Shape.RESTLESS),
        (0.04 * grey(STRAIGHT), 0.04 * grey(STRAIGHT), Shape.DARK),
        (grey(STRAIGHT), 1.2 * grey(STRAIGHT), Shape.STRAIGHT),  # all of it brighter in the second pass: as good a sine
        # A code that comes out darker than a lower one is a wrong bit.
        (grey(FALLS - 0.001 * (CODES[30] == CODES)), grey(FALLS - 0.001 * (CODES[30] == CODES)), Shape.STRAIGHT),
        (grey(FALLS - 0.003 * (CODES[30] == CODES)), grey(FALLS - 0.003 * (CODES[30] == CODES)), Shape.BIT_PLANES),
    ],
)
def test_grey_that_changes_is_dark_or_falls_is_told(
    first: NDArray[np.float64], second: NDArray[np.float64], shape: Shape
) -> None:
    assert judge_response(CODES, first, second).shape is shape


def test_an_exposure_begins_with_a_sub_frame_and_holds_whole_ones() -> None:
    timing = LightTiming(1, 300.0, 16_600.0, ())
    assert trials(timing, 3, PERIOD_US) == (Trial(300, 5_556), Trial(300, 11_111))
    late = LightTiming(1, 6_010.0, 22_500.0, ())
    assert {one.delay_us for one in trials(late, 1, PERIOD_US)} == {6_050}
    assert max(one.exposure_us for one in trials(late, 1, PERIOD_US)) == 16_000
    green = trials(LightTiming(0, 5_000.0, 12_400.0, ()), 1, PERIOD_US)
    assert Trial(4_750, 7_900) in green, "from before the light until after it"
    assert all(one.delay_us + one.exposure_us <= PERIOD_US for one in green)


@pytest.mark.parametrize(("begins_us", "fits"), [(5_455.0, True), (5_456.0, False)])
def test_an_exposure_ends_a_tenth_of_a_millisecond_before_the_next_picture(begins_us: float, fits: bool) -> None:
    found = trials(LightTiming(1, begins_us, 16_600.0, ()), 3, PERIOD_US)
    assert (Trial(round(begins_us), 11_111) in found) is fits


def test_what_brings_no_more_light_is_not_offered() -> None:
    straight = judge_response(CODES, grey(CODES / 255.0), grey(CODES / 255.0))
    measured = {Trial(500, time): straight for time in (8_000, 10_000, 12_000)} | {Trial(0, 16_000): straight}
    offer = best_offer(measured, lambda trial: min(trial.exposure_us, 9_000))
    assert offer is not None
    assert (offer.delay_us, offer.exposures_us) == (500, (8_000, 10_000))
    assert best_offer({}, lambda _trial: 0.0) is None


def test_lines_that_differ_beat_and_a_slow_course_does_not() -> None:
    x = np.linspace(-1.0, 1.0, LINES)
    noise = 0.002 * np.random.default_rng(3).standard_normal((2, LINES))
    smooth = 1.0 + 0.2 * x - 0.1 * x**2
    assert not compare_lines(smooth + noise[0], smooth + noise[1]).is_scaled
    beating = smooth * (1.0 + 0.1 * (np.arange(LINES) % 4 == 0))
    found = compare_lines(beating + noise[0], beating + noise[1])
    assert found.is_scaled
    assert found.beating == pytest.approx(0.043, abs=0.01)
    dim = compare_lines(beating**9 + 80 * noise[0], beating**9 + 80 * noise[1])
    assert dim.beating > 0.2
    assert not dim.is_measurable
    assert not dim.is_scaled


def test_a_key_is_changed_in_its_line_and_everything_else_stays() -> None:
    new: dict[tuple[str, str], Any] = {("projector", "latency_blanks"): 1, ("board", "trigger_delay_us"): 250, ("scan", "exposures_ms"): (8.0, 12.0), ("projector", "channels"): "all"}  # fmt: skip
    text = with_keys(PACKAGED, {KeyValue(*key): value for key, value in new.items()})
    rig = parse_rig(text)
    assert {(table, key): getattr(getattr(rig, table), key) for table, key in new} == new
    lines, old = text.split("\n"), PACKAGED.split("\n")
    assert len(lines) == len(old) + 3, "three keys are new"
    kept = [line for line in old if line != "trigger_delay_us = 500"]
    assert [line for line in lines if line in kept] == kept, "all other lines, in their order"
    again = with_keys(text, {KeyValue("camera.right", "gain_db"): 3.0})
    assert parse_rig(again).camera.left.gain_db == 0.0, "a key of a table is not looked for in another"
    again = with_keys(text, {KeyValue("projector", "latency_blanks"): 2})
    assert again == text.replace("latency_blanks = 1\n", "latency_blanks = 2\n", 1)
    text = with_keys(PACKAGED, {KeyValue("camera.left", "full_well_e"): 9000.0})
    assert "\nfull_well_e = 9000.0       # data sheet" in text, "a comment behind a value stays"


@pytest.mark.parametrize(
    ("old", "new", "key", "value", "named"),
    [
        ("[scan]\n", "[scan]\nexposures_ms = [\n  12.0,\n]\n", KeyValue("scan", "exposures_ms"), (12.0,), "scan.exposures_ms"),
        ("[water]\n", "[waters]\n", KeyValue("water", "salinity_psu"), 1.0, r"\[water\]"),
        ("", "", KeyValue("projector", "latency_blanks"), 9, r"projector\.latency_blanks 9"),
    ],
)  # fmt: skip
def test_what_cannot_be_edited_by_lines_or_makes_no_rig_file_is_left_to_a_person(
    old: str, new: str, key: KeyValue, value: Any, named: str
) -> None:
    with pytest.raises(BringupError, match=named):
        with_keys(PACKAGED.replace(old, new, 1), {key: value})


def test_what_single_bits_foretell_to_be_cut_is_not_tried() -> None:
    """Bits one after the other, the largest first, within 1 to 9 ms: an exposure of a part of that loses some."""
    at, profiles = 1_000.0, {}
    for bit in range(7, -1, -1):
        length = 8_000.0 * 2**bit / 255.0
        profiles[2**bit] = slices((at, at + length))
        at += length
    profiles[255] = np.asarray(sum(profiles.values()), np.float64)
    wanted = [Trial(500, 250 * k) for k in range(8, 60)]
    kept = promising_trials(wanted, profiles, 0.0)
    assert {one.exposure_us for one in kept} >= {one.exposure_us for one in wanted if one.exposure_us >= 8_500}
    assert len(kept) < 0.7 * len(wanted)
    assert promising_trials(wanted[: light.FEWEST], profiles, 0.0) == tuple(wanted[: light.FEWEST]), (
        "a few are always tried"
    )
    del profiles[4]
    assert promising_trials(wanted, profiles, 0.0) == tuple(wanted), "a bit that was not measured may be anywhere"


PERIOD_PX = 32


def coordinate(
    amplitudes_px: tuple[float, float, float] = (0.0, 0.0, 0.0),
    noise_px: float = 0.02,
    shape: tuple[int, int] = (150, 200),
) -> NDArray[np.float32]:
    """Columns of a pattern on a leaning plane behind a lens, rippled at 1, 2 and 4 cycles, with holes and some wrong periods."""
    rng = np.random.default_rng(3)
    y, x = np.mgrid[-1.0 : 1.0 : shape[0] * 1j, -1.0 : 1.0 : shape[1] * 1j]
    true = 500.0 + 380.0 * x / (1.0 + 0.08 * x + 0.05 * y) + 20.0 * y + 6.0 * x * (x**2 + y**2)
    theta = 2.0 * np.pi * (true + 0.5) / PERIOD_PX
    p = true + noise_px * rng.standard_normal(shape)
    for k, amplitude in zip((1, 2, 4), amplitudes_px, strict=True):
        p += amplitude * np.cos(k * theta - 0.7)
    p[rng.random(shape) < 0.1] = np.nan
    p[rng.random(shape) < 0.01] += PERIOD_PX
    return np.asarray(p, np.float32)


def ripple(**made: object) -> CoordinateRipple:
    plane = smooth_plane(coordinate(**made), PERIOD_PX)  # type: ignore[arg-type]
    assert plane is not None
    return ripple_of(plane, PERIOD_PX)


@pytest.mark.parametrize("k", [0, 1, 2])
def test_a_ripple_is_measured_at_its_own_number_of_cycles(k: int) -> None:
    wanted = [0.0, 0.0, 0.0]
    wanted[k] = 0.08
    found = ripple(amplitudes_px=tuple(wanted))
    assert found.amplitude_px == pytest.approx(tuple(wanted), abs=5.0 * found.uncertainty_px)
    assert found.uncertainty_px == pytest.approx(0.02 * np.sqrt(2.0 / 27_000), rel=0.1)
    assert found.noise_px == pytest.approx(0.02, rel=0.1)


def test_a_step_in_depth_and_an_empty_image_are_no_plane() -> None:
    assert smooth_plane(np.full((60, 80), np.nan, np.float32), PERIOD_PX) is None
    # A second surface in a corner is left out, and the ripple of the plane is what it was.
    p = coordinate((0.0, 0.0, 0.05))
    p[:40, :50] += 7.0
    plane = smooth_plane(p, PERIOD_PX)
    assert plane is not None
    assert ripple_of(plane, PERIOD_PX).amplitude_px[2] == pytest.approx(0.05, abs=0.005)


def test_a_saturated_plane_is_tried_with_half_of_the_light_then_with_what_is_left() -> None:
    allowed = [Exposure(us, 0.0) for us in (2000, 5000, 8000, 12_000)]
    assert next_exposure(allowed, allowed[3], 0.005) is None
    assert next_exposure(allowed, allowed[3], 0.3) == allowed[1]
    assert next_exposure(allowed[2:], allowed[3], 0.3) == allowed[2]
    assert next_exposure(allowed, allowed[0], 0.3) is None
