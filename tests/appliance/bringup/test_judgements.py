"""The bring-up's judgements by themselves: a flash, its windows and sub-frames, grey, lines, and edits of a rig file."""

from __future__ import annotations

import tomllib

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.bringup.bench import lit_part
from appliance.bringup.exposures import FEWEST, Trial, offered, promising, trials
from appliance.bringup.finding import BringupError
from appliance.bringup.light import (
    SLICE_US,
    LightTiming,
    LightWindow,
    latency_of,
    light_within,
    sub_frames_of,
    timing_of,
    windows_of,
)
from appliance.bringup.orientation import Orientation, SeenPicture
from appliance.bringup.projector import ProjectorMeasured
from appliance.bringup.projector_steps import projector_outcomes
from appliance.bringup.raster import LINES, checker, compare_lines, line_pictures
from appliance.bringup.response_check import Shape, judge_response, ramp_codes, shuffled
from appliance.bringup.rig_edit import KeyValue, with_keys
from appliance.config import default_rig_path, parse_rig

PERIOD_US = 1e6 / 60.0
PACKAGED = default_rig_path().read_text(encoding="utf-8")
CODES = ramp_codes(62).astype(np.float64)


def slices(*windows_us: tuple[float, float], count: int = 200) -> NDArray[np.float64]:
    """Return a profile of a lamp of 10 grey values a slice, on in these windows."""
    edges = 250.0 * np.arange(count + 1)
    lit = [np.clip(np.minimum(edges[1:], end) - np.maximum(edges[:-1], begin), 0.0, None) for begin, end in windows_us]
    return np.asarray(10.0 * np.sum(lit, axis=0) / 250.0, np.float64)


@pytest.mark.parametrize("at", range(6))
def test_the_first_lit_frame_is_the_latency(at: int) -> None:
    levels = np.full(24, 2.0)
    levels[at] = 150.0
    assert latency_of(levels) == at
    levels[at + 1] = 80.0
    assert latency_of(levels) == at, "the light goes on beyond a blank"
    levels[at + 1] = 2.0 + 148.0 * 0.02
    assert latency_of(levels) == at
    levels += np.tile([0.3, -0.3, 0.0], 8)
    assert latency_of(levels) == at, "noise is no flash"
    levels[at : at + 2] = 6.0, 2.0
    assert latency_of(levels) == at, "nor is it beside a faint one"


def test_a_flash_that_is_none_or_too_long_is_refused() -> None:
    levels = np.full(24, 2.0)
    with pytest.raises(BringupError, match=r"changed the images by 0\.0 grey values; 3 are needed"):
        latency_of(levels)
    levels[1:5] = 100.0
    with pytest.raises(BringupError, match="lit 4 frames in a row; allowed are 2"):
        latency_of(levels)


@pytest.mark.parametrize("begin", [0.0, 130.0, 250.0, 5_120.0])
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
    with pytest.raises(BringupError, match="no light was seen"):
        timing_of(np.zeros(200), PERIOD_US)


def test_light_between_two_times_is_the_lamps() -> None:
    assert light_within(slices((1_000.0, 2_000.0)), 1_500.0, 9_000.0) == pytest.approx(20.0)


@pytest.mark.parametrize("count", [2, 3, 4])
def test_equal_parts_of_a_frame_are_counted(count: int) -> None:
    step = PERIOD_US / count
    bits = [
        slices(*((k * step + 500.0, k * step + 500.0 + length) for k in range(count))) for length in (3_000.0, 1_700.0)
    ]
    assert sub_frames_of(bits, 0.0, PERIOD_US) == count
    # One bit that comes in the first part only: parts are not equal.
    assert sub_frames_of([*bits, slices((500.0, 2_500.0))], 0.0, PERIOD_US) == 1
    # The same course, a fifth dimmer in the first part and brighter in the last: what is between is as bright as the mean.
    lights = np.ones(200)
    lights[: int(step / 250.0)], lights[int((count - 1) * step / 250.0) + 1 :] = 0.8, 1.2
    assert sub_frames_of([bit * lights for bit in bits], 0.0, PERIOD_US) == 1
    # As much light, a millisecond later in the last part.
    late = [k * step + 500.0 + 1_000.0 * (k == count - 1) for k in range(count)]
    shifted = [slices(*((begin, begin + length) for begin in late)) for length in (3_000.0, 1_700.0)]
    assert sub_frames_of(shifted, 0.0, PERIOD_US) == 1
    assert sub_frames_of([slices((0.0, PERIOD_US))], 0.0, PERIOD_US) == 1, "steady light repeats with any number"
    assert sub_frames_of([np.zeros(200)], 0.0, PERIOD_US) == 1


def grey(curve: NDArray[np.float64], noise: float = 0.0, seed: int = 1) -> NDArray[np.float64]:
    return 2.0 + 150.0 * (curve + noise * np.random.default_rng(seed).standard_normal(len(curve)))


@pytest.mark.parametrize(
    ("curve", "shape"),
    [
        (CODES / 255.0, Shape.STRAIGHT),
        ((CODES / 255.0) ** 1.1, Shape.CURVED),
        ((CODES / 255.0) ** 2.2, Shape.GAMMA),
        ((CODES / 255.0) ** 0.45, Shape.GAMMA),
        (CODES / 255.0 + 0.05 * (CODES >= 128), Shape.BIT_PLANES),
        (CODES / 255.0 - 0.02 * (CODES % 32 >= 16), Shape.BIT_PLANES),
        (np.sin(0.6 * np.pi * CODES / 255.0), Shape.BIT_PLANES),
    ],
)
def test_grey_is_straight_curved_gamma_or_cut(curve: NDArray[np.float64], shape: Shape) -> None:
    found = judge_response(CODES, grey(curve, 0.001, 1), grey(curve, 0.001, 2))
    assert found.shape is shape
    assert found.usable == (shape in (Shape.STRAIGHT, Shape.CURVED))
    backwards = np.argsort(-CODES)
    again = judge_response(CODES[backwards], grey(curve, 0.001, 1)[backwards], grey(curve, 0.001, 2)[backwards])
    assert again.shape is shape, "in whatever order the codes were shown"


def test_grey_that_changes_or_is_too_dark_is_not_judged() -> None:
    straight = CODES / 255.0
    assert judge_response(CODES, grey(straight, 0.02, 1), grey(straight, 0.02, 2)).shape is Shape.RESTLESS
    assert judge_response(CODES, 0.04 * grey(straight), 0.04 * grey(straight)).shape is Shape.DARK
    # All of it a fifth brighter in the second pass: as good a sine.
    assert judge_response(CODES, grey(straight), 1.2 * grey(straight)).shape is Shape.STRAIGHT


@pytest.mark.parametrize(("fall", "shape"), [(0.001, Shape.STRAIGHT), (0.003, Shape.BIT_PLANES)])
def test_a_code_that_comes_out_darker_than_a_lower_one_is_a_wrong_bit(fall: float, shape: Shape) -> None:
    curve = CODES / 255.0
    curve[30] = curve[29] - fall
    assert judge_response(CODES, grey(curve), grey(curve)).shape is shape


def test_a_ramp_has_both_ends_and_both_sides_of_each_step() -> None:
    codes = set(ramp_codes(62).tolist())
    assert len(codes) == 62
    assert {0, 255, 127, 128, 63, 64, 191, 192} <= codes
    orders = [shuffled(62, seed).tolist() for seed in (0, 1)]
    assert sorted(orders[0]) == list(range(62))
    assert orders[0] != orders[1]
    assert min(abs(a - b) for a, b in zip(orders[0], orders[0][3:], strict=False)) <= 61
    assert np.corrcoef(orders[0][:-1], orders[0][1:])[0, 1] < 0.3, "neighbours in time are none in grey"


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


def test_the_drawn_light_begins_and_ends_at_the_lines_of_its_window() -> None:
    window = LightWindow(6 * SLICE_US, 12 * SLICE_US)
    timing = LightTiming(0, window.begins_us, window.ends_us, (window,))
    profiles = {255: slices((window.begins_us, window.ends_us), count=20)}
    seen = dict.fromkeys(("left", "right"), SeenPicture(Orientation.UPRIGHT, None))
    measured = ProjectorMeasured(timing, "green", 1, 0.0, profiles, {}, {}, None, {}, seen, {})
    _, png = projector_outcomes(measured, 60.0, {})["light"].pictures["light.png"]
    image = np.asarray(cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR), np.int64)[
        :, :-250
    ]  # without the curve's name
    blue, red = image[..., 0] - image[..., 2] > 100, image[..., 2] - image[..., 0] > 100
    rows = np.flatnonzero(blue.any(axis=1))
    edges = np.flatnonzero(red.sum(axis=0) > 150).tolist()
    assert len(edges) == 2
    for edge in edges:
        # From dark to light within a slice, whose middle is the edge.
        middle = np.flatnonzero(blue[:, edge - 2 : edge + 3].any(axis=1)).mean()
        assert middle == pytest.approx(rows.mean(), abs=0.1 * len(rows))


def test_what_brings_no_more_light_is_not_offered() -> None:
    straight = judge_response(CODES, grey(CODES / 255.0), grey(CODES / 255.0))
    measured = {Trial(500, time): straight for time in (8_000, 10_000, 12_000)} | {Trial(0, 16_000): straight}
    offer = offered(measured, lambda trial: min(trial.exposure_us, 9_000))
    assert offer is not None
    assert (offer.delay_us, offer.exposures_us) == (500, (8_000, 10_000))
    assert offered({}, lambda _trial: 0.0) is None


def test_lines_that_differ_beat_and_a_slow_course_does_not() -> None:
    x = np.linspace(-1.0, 1.0, LINES)
    noise = 0.002 * np.random.default_rng(3).standard_normal((2, LINES))
    smooth = 1.0 + 0.2 * x - 0.1 * x**2
    assert not compare_lines(smooth + noise[0], smooth + noise[1]).scaled
    beating = smooth * (1.0 + 0.1 * (np.arange(LINES) % 4 == 0))
    found = compare_lines(beating + noise[0], beating + noise[1])
    assert found.scaled
    assert found.beating == pytest.approx(0.043, abs=0.01)
    dim = compare_lines(beating**9 + 80 * noise[0], beating**9 + 80 * noise[1])
    assert dim.beating > 0.2
    assert not dim.told
    assert not dim.scaled


def test_lines_are_single_and_a_checker_alternates() -> None:
    columns, rows = line_pictures((64, 48), rows=False), line_pictures((64, 48), rows=True)
    assert [int(np.flatnonzero(p[0])[0]) for p in columns] == list(range(20, 44))
    assert [int(np.flatnonzero(p[:, 0])[0]) for p in rows] == list(range(12, 36))
    assert np.array_equal(checker((3, 2)), [[0, 255, 0], [255, 0, 255]])


def test_what_is_lit_is_neither_dark_nor_saturated() -> None:
    black = np.full((4, 5), 2, np.uint8)
    white = black.copy()
    white[1:3, 1:4] = 200
    white[1, 1], white[2, 2] = 255, 60
    assert lit_part(white, black).sum() == 4
    assert not lit_part(black, black).any()


def test_a_key_is_changed_in_its_line_and_everything_else_stays() -> None:
    text = with_keys(
        PACKAGED,
        {
            KeyValue("projector", "latency_blanks"): 1,
            KeyValue("board", "trigger_delay_us"): 250,
            KeyValue("scan", "exposures_ms"): (8.0, 12.0),
            KeyValue("projector", "channels"): "all",
        },
    )
    rig = parse_rig(text)
    assert (rig.projector.latency_blanks, rig.board.trigger_delay_us, rig.projector.channels) == (1, 250, "all")
    assert rig.scan.exposures_ms == (8.0, 12.0)
    old, new = PACKAGED.split("\n"), text.split("\n")
    assert len(new) == len(old) + 3, "three keys are new"
    kept = [line for line in old if line != "trigger_delay_us = 500"]
    assert [line for line in new if line in kept] == kept, "all other lines, in their order"
    again = with_keys(text, {KeyValue("projector", "latency_blanks"): 2})
    assert again == text.replace("latency_blanks = 1\n", "latency_blanks = 2\n", 1)
    delay = next(
        line
        for line in with_keys(PACKAGED, {KeyValue("camera.left", "full_well_e"): 9000.0}).split("\n")
        if "full_well_e" in line
    )
    assert delay.startswith("full_well_e = 9000.0       # data sheet"), "a comment behind a value stays"


def test_a_key_of_a_table_is_not_looked_for_in_another() -> None:
    changed = with_keys(PACKAGED, {KeyValue("camera.right", "gain_db"): 3.0})
    rig = parse_rig(changed)
    assert (rig.camera.left.gain_db, rig.camera.right.gain_db) == (0.0, 3.0)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            "[scan]\n",
            "[scan]\nexposures_ms = [\n  12.0,\n]\n",
            "cannot be edited by lines; set by hand: scan.exposures_ms",
        ),
        ("[water]\n", "[waters]\n", None),
    ],
)
def test_what_cannot_be_edited_by_lines_is_left_to_a_person(old: str, new: str, said: str | None) -> None:
    text = PACKAGED.replace(old, new, 1)
    if said is None:
        with pytest.raises(BringupError, match=r"no line \[water\]"):
            with_keys(text, {KeyValue("water", "salinity_psu"): 1.0})
        return
    assert tomllib.loads(text)
    with pytest.raises(BringupError, match=said):
        with_keys(text, {KeyValue("scan", "exposures_ms"): (12.0,)})


def test_what_makes_no_rig_file_is_refused() -> None:
    with pytest.raises(BringupError, match=r"what was measured makes no rig file: CONFIG: projector\.latency_blanks 9"):
        with_keys(PACKAGED, {KeyValue("projector", "latency_blanks"): 9})


def test_what_single_bits_foretell_to_be_cut_is_not_tried() -> None:
    """Bits one after the other, the largest first, within 1 to 9 ms: an exposure of a part of that loses some."""
    at, profiles = 1_000.0, {}
    for bit in range(7, -1, -1):
        length = 8_000.0 * 2**bit / 255.0
        profiles[2**bit] = slices((at, at + length))
        at += length
    profiles[255] = np.asarray(sum(profiles.values()), np.float64)
    wanted = [Trial(500, 250 * k) for k in range(8, 60)]
    kept = promising(wanted, profiles, 0.0)
    assert {one.exposure_us for one in kept} >= {one.exposure_us for one in wanted if one.exposure_us >= 8_500}
    assert len(kept) < 0.7 * len(wanted)
    assert promising(wanted[:FEWEST], profiles, 0.0) == tuple(wanted[:FEWEST]), "a few are always tried"
    del profiles[4]
    assert promising(wanted, profiles, 0.0) == tuple(wanted), "a bit that was not measured may be anywhere"
