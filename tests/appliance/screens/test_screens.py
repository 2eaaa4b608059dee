"""What a diver would notice on the screens."""

from __future__ import annotations

import re
import time
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import moderngl
import numpy as np
import pytest
from numpy.typing import NDArray

import appliance
from appliance.machine.alerts import Alert, Severity
from appliance.machine.states import State
from appliance.machine.states import boot as machine_at_boot
from appliance.machine.texts import labels as machine_labels
from appliance.machine.words import Language, Text
from appliance.optics.volume import WorkingVolume
from appliance.ranging.reach import Range, Reach, reach_of
from appliance.scan.fault import FaultCode
from appliance.scan.grade import Grade
from appliance.screens import theme
from appliance.screens.canvas import MAX_WORDS, Canvas
from appliance.screens.frame import ALERT_PX, MARKS_PX, alert_colours
from appliance.screens.painter import Painter
from appliance.screens.views import (
    AimView,
    AnyView,
    ArmedView,
    BootView,
    CaptureView,
    CheckView,
    CoolingView,
    DeviceLine,
    DeviceResult,
    GalleryView,
    Gauge,
    MenuRow,
    MenuView,
    ReconstructView,
    ReviewView,
    SafeView,
    SavingView,
    SelfTestView,
    ShutdownView,
    labels,
)
from drivers.api import Key

Picture = NDArray[np.uint8]
LEAK = Alert(FaultCode.LEAK, Severity.CRITICAL, "LEAK", "ASCEND")
LOST = Alert(FaultCode.CAMERA_LOST, Severity.WARNING, "RIGHT CAM LOST", "OFF AND ON, OR END DIVE")
NEWS = Alert(FaultCode.BOARD_RESET, Severity.INFO, "BOARD RESET", "NOTHING TO DO")
RED = (0xFF, 0x3B, 0x3B)
"""Of the edge of a critical alert, in both halves of its flashing."""
GREY = np.full((1200, 1600), 90, np.uint8)
AIM = AimView(left=GREY, right=GREY, scans_taken=12, scans_left=41, temperature_c=34.0)
POINTS = np.random.default_rng(2).uniform((-100, -80, 480), (100, 80, 520), (4000, 3)).astype(np.float32)
REVIEW = ReviewView(
    points_mm=POINTS, values=POINTS[:, 2].copy(), coarse=False, grade=Grade.GOOD, points=4000,
    coverage_percent=87.0, noise_mm=0.028, distance_mm=503.0, duration_s=0.8,
)  # fmt: skip
EVERY: list[AnyView] = [
    BootView(
        devices=(DeviceLine("camera.left", DeviceResult.WORKS), DeviceLine("odd", DeviceResult.FAILED)), version="1"
    ),
    AIM,
    SelfTestView(
        devices=tuple(
            DeviceLine(name, DeviceResult.WORKS)
            for name in ("camera.left", "camera.right", "board", "keys", "projector", "display", "storage", "worker")
        ),
        version="1",
        finished=True,
        passed=True,
    ),
    ArmedView(),
    CaptureView(),
    CheckView(),
    ReconstructView(),
    REVIEW,
    MenuView(title=Text.MENU, rows=(MenuRow(Text.EXPOSURE, "10 ms"), MenuRow(Text.ABOUT)), selected=0),
    GalleryView(
        scan_id="000007",
        index=2,
        count=9,
        preview=np.full((480, 800, 3), (30, 90, 60), np.uint8),
        grade=Grade.USABLE,
        points=812_345,
        coverage_percent=71.0,
        noise_mm=0.041,
        distance_mm=488.0,
        taken=None,
    ),
    GalleryView(),
    CoolingView(temperature_c=61.0, limit_c=55.0, remaining_s=130.0),
    SafeView(alert=LEAK, saved=True),
    SavingView(scan_id="000007", saved=False),
    SavingView(scan_id="000007", saved=True),
    ShutdownView(reason=LOST, saving=True),
]


def drawn(painter: Painter, view: AnyView, time_s: float = 0.0) -> Picture:
    return painter.draw(view, time_s).copy()


def corner(picture: Picture, key: Key) -> Picture:
    right, bottom = theme.KEY_CORNERS[key].value
    return picture[-54:, ...][:, -96:] if bottom and right else (
        picture[-54:, :96] if bottom else picture[:54, -96:] if right else picture[:54, :96]
    )  # fmt: skip


# ------------------------------------------------------------------------------------ in general


@pytest.mark.parametrize("view", EVERY, ids=lambda view: type(view).__name__)
@pytest.mark.parametrize("language", list(Language))
def test_every_screen_has_something_to_read(context: moderngl.Context, view: AnyView, language: Language) -> None:
    with Painter(context, (800, 480), language) as painter:
        picture = drawn(painter, view)
    assert picture.shape == (480, 800, 3)
    assert picture.dtype == np.uint8
    edges = np.abs(np.diff(picture.mean(axis=2), axis=1)) > 120
    assert edges.mean() > 0.002  # letters of high contrast


@pytest.mark.parametrize("size_px", [(640, 480), (1024, 600), (1280, 800)])
def test_other_displays_are_filled_to_their_edges(context: moderngl.Context, size_px: tuple[int, int]) -> None:
    with Painter(context, size_px) as painter:
        picture = drawn(painter, AIM)
    assert picture.shape == (size_px[1], size_px[0], 3)
    assert (picture[2:20, -4:] > 100).any()  # the mark of the SCAN key at the upper right edge
    assert (picture[-20:-2, -4:] > 100).any()


def test_the_same_memory_is_used_each_time(painter: Painter) -> None:
    assert painter.draw(AIM, 0.0) is painter.draw(replace(AIM, scans_taken=13), 0.1)


def test_ever_new_numbers_do_not_fill_the_memory(context: moderngl.Context) -> None:
    with context:
        canvas = Canvas(context, (800, 480))
        canvas.begin(theme.INK)
        for number in range(3 * MAX_WORDS):
            canvas.words(f"{number} mm", 10, 100)
        assert len(canvas._words) == MAX_WORDS
        canvas.close()


def test_other_drawing_on_the_context_does_not_disturb(context: moderngl.Context, painter: Painter) -> None:
    before = drawn(painter, REVIEW)
    with context:
        canvas = context.simple_framebuffer((32, 32))
        canvas.use()
        context.disable(moderngl.BLEND)
        context.enable(moderngl.DEPTH_TEST)
        canvas.clear(1.0, 1.0, 1.0, 1.0)
    np.testing.assert_array_equal(drawn(painter, REVIEW), before)


# ------------------------------------------------------------------------------------------ keys


@pytest.mark.parametrize("key", list(Key))
def test_a_label_stands_at_its_own_key_only(painter: Painter, key: Key) -> None:
    bare = drawn(painter, CaptureView(keys={}))
    labelled = drawn(painter, CaptureView(keys=labels(**{key.value: Text.OK})))
    for other in Key:
        changed = not np.array_equal(corner(bare, other), corner(labelled, other))
        assert changed == (other is key)


def test_a_word_that_is_no_entry_of_the_table_is_not_translated(context: moderngl.Context) -> None:
    """Nothing is looked up by its English: a name that happens to be a word stays that name."""
    with Painter(context, (800, 480), Language.GERMAN) as painter:
        drawn(
            painter,
            replace(REVIEW, keys={Key.SCAN: "KEEP", Key.BACK: Text.HOLD_REDO, Key.DOWN: (Text.HOLD_ADD, "0.5 ms")}),
        )
        written = " ".join(line.words for line in painter.canvas.written)
    assert "KEEP" in written
    assert "BEHALTEN" not in written
    assert "HALTEN: NOCHMAL" in written
    assert "0,5 ms" in written


def test_every_label_of_the_machine_can_be_translated() -> None:
    state = machine_at_boot(0)
    words = [word for s in State for word in machine_labels(replace(state, state=s)).values()]
    assert words
    assert all(isinstance(word[0] if isinstance(word, tuple) else word, Text) for word in words)


def test_no_word_of_the_table_is_left_over() -> None:
    """Each is asked for by its name somewhere in the product."""
    folder = Path(appliance.__file__).parent
    asked = {
        name for path in folder.rglob("*.py") for name in re.findall(r"\bText\.(\w+)", path.read_text(encoding="utf-8"))
    }
    assert not {text.name for text in Text} - asked


def test_a_refused_scan_has_a_dim_label(painter: Painter) -> None:
    allowed, refused = drawn(painter, AIM), drawn(painter, replace(AIM, scan_allowed=False))
    assert corner(allowed, Key.SCAN).mean() > 2 * corner(refused, Key.SCAN).mean()


@pytest.mark.parametrize("language", list(Language))
@pytest.mark.parametrize(
    "text",
    [Text.SCAN, Text.OK, Text.KEEP, Text.REPEAT, Text.BACK, Text.HOLD_OFF, Text.TURN, Text.SEEN, Text.RETRY],
)
def test_labels_keep_nearly_their_full_size(context: moderngl.Context, language: Language, text: Text) -> None:
    with context:
        canvas = Canvas(context, (800, 480))
        width = canvas.measure(text.in_language(language), theme.BODY, theme.BLACK)
        canvas.close()
    assert width <= (theme.LABEL_MAX_PX - 48) / 0.8


# ---------------------------------------------------------------------------------------- alerts


def test_a_warning_is_solid_yellow(painter: Painter) -> None:
    first, later = (drawn(painter, replace(AIM, alerts=(LOST,)), t) for t in (0.0, 0.5 / theme.FLASH_HZ))
    np.testing.assert_array_equal(first, later)
    assert (np.abs(first.astype(int) - (255, 210, 31)).max(axis=2) < 3).mean() > 0.1


def test_a_critical_alert_flashes_and_is_readable_in_both_halves(painter: Painter) -> None:
    bright, dark = (drawn(painter, replace(AIM, alerts=(LEAK,)), t) for t in (0.0, 0.6 / theme.FLASH_HZ))
    red_bright, red_dark = (((p[:, :, 0] > 140) & (p[:, :, 1] < 70)).mean() for p in (bright, dark))
    assert red_bright > 0.15
    assert red_dark < 0.06
    white = [(p[280:418, 100:].min(axis=2) > 230) for p in (bright, dark)]
    assert white[0].sum() > 2000
    assert (white[0] == white[1]).mean() > 0.99  # the same words in the same place


def test_flashing_stays_below_three_per_second() -> None:
    bright = [theme.flash_on(t / 1000) for t in range(10_000)]
    starts = sum(later and not earlier for earlier, later in pairwise(bright))
    assert 10 <= starts < 30


@pytest.mark.parametrize("alerts", [(LOST, LEAK), (LEAK, LOST), (NEWS, LOST, LEAK)])
def test_the_gravest_alert_wins_whatever_the_order(painter: Painter, alerts: tuple[Alert, ...]) -> None:
    picture = drawn(painter, replace(AIM, alerts=alerts))
    assert tuple(picture[316, 797]) == RED


def test_further_alerts_are_named_above_the_gravest(painter: Painter) -> None:
    one, two = (drawn(painter, replace(AIM, alerts=alerts)) for alerts in ((LOST,), (LOST, NEWS)))
    band = 480 - theme.BAR_PX - ALERT_PX
    np.testing.assert_array_equal(one[band:], two[band:])  # the band itself is as it was
    mark = (two[band - MARKS_PX : band, :40] == 244).any(axis=2)  # the white bullet of news
    assert mark.any()
    assert not (one[band - MARKS_PX : band, :8] > 200).any()


@pytest.mark.parametrize("severity", list(Severity))
@pytest.mark.parametrize("time_s", [0.0, 0.6 / theme.FLASH_HZ])
def test_alert_words_have_contrast_in_grey(severity: Severity, time_s: float) -> None:
    ground, ink, _ = alert_colours(severity, time_s)
    high, low = sorted((ground.luminance, ink.luminance), reverse=True)
    assert (high + 0.05) / (low + 0.05) >= theme.LEAST_CONTRAST


@pytest.mark.parametrize("view", EVERY, ids=lambda view: type(view).__name__)
def test_an_alert_is_on_top_on_every_screen(painter: Painter, view: AnyView) -> None:
    picture = drawn(painter, replace(view, alerts=(LEAK,)))
    assert tuple(picture[316, 797]) == RED


# ------------------------------------------------------------------------------------------- aim


def test_live_pictures_are_upright_and_on_their_own_side(painter: Painter) -> None:
    left, right = np.full((1200, 1600), 20, np.uint8), np.full((1200, 1600), 20, np.uint8)
    left[600:, :800] = 200  # lower left quarter
    right[:600, 800:] = 150  # upper right quarter
    picture = drawn(painter, replace(AIM, left=left, right=right))[:, :, 0].astype(int)
    assert picture[350, 100] == pytest.approx(200, abs=2)
    assert picture[200, 300] == pytest.approx(20, abs=2)
    assert picture[200, 700] == pytest.approx(150, abs=2)
    assert picture[350, 500] == pytest.approx(20, abs=2)


def test_a_lost_camera_leaves_no_old_picture_behind(painter: Painter) -> None:
    bright = np.full((1200, 1600), 240, np.uint8)
    drawn(painter, replace(AIM, right=bright))
    picture = drawn(painter, replace(AIM, right=None))
    assert picture[170:410, 420:780].mean() < 40
    assert picture[170:410, 60:380].mean() == pytest.approx(90, abs=3)


def test_a_picture_that_changed_in_place_is_shown_anew(painter: Painter) -> None:
    live = np.full((1200, 1600), 50, np.uint8)
    drawn(painter, replace(AIM, left=live))
    live[:] = 160
    assert drawn(painter, replace(AIM, left=live))[300, 200, 0] == pytest.approx(160, abs=2)


def test_saturation_is_striped(painter: Painter) -> None:
    live = np.full((1200, 1600), 255, np.uint8)
    area = drawn(painter, replace(AIM, left=live))[170:410, 60:380, 0]
    assert 0.2 < (area < 30).mean() < 0.6
    almost = drawn(painter, replace(AIM, left=np.full_like(live, 245)))[170:410, 60:380, 0]
    assert almost.min() > 240


def test_unknown_is_not_zero(painter: Painter) -> None:
    bar = slice(420, 480)
    unknown = drawn(painter, replace(AIM, temperature_c=None, scans_left=None))[bar]
    zero = drawn(painter, replace(AIM, temperature_c=0.0, scans_left=0))[bar]
    assert (unknown != zero).any(axis=2).sum() > 100


def gauge(distance_mm: float | None, tilt_deg: float | None = None) -> Gauge:
    measured = None if distance_mm is None else Range(distance_mm, tilt_deg, 0.5, 2)
    return Gauge(distance_mm, tilt_deg, reach_of(measured))


@pytest.mark.parametrize(("distance_mm", "yellow"), [(500.0, False), (445.0, False), (430.0, True), (700.0, True)])
def test_the_gauge_warns_outside_the_volume(painter: Painter, distance_mm: float, yellow: bool) -> None:
    band = drawn(painter, replace(AIM, gauge=gauge(distance_mm)))[64:118]
    is_yellow = (np.abs(band.astype(int) - (255, 210, 31)).max(axis=2) < 20).sum() > 150
    assert is_yellow == yellow


def test_the_scale_is_that_of_the_housing(painter: Painter) -> None:
    """300 mm in a housing for 300 mm look as 500 mm do in one for 500 mm, but for the number."""
    small = WorkingVolume(264.0, 300.0, 336.0)
    scale = np.s_[64:118, 190:500]
    mine = drawn(painter, replace(AIM, gauge=Gauge(300.0, None, Reach.OK, small)))[scale]
    assert (mine == drawn(painter, replace(AIM, gauge=Gauge(500.0, None, Reach.OK)))[scale]).all()
    assert (mine != drawn(painter, replace(AIM, gauge=Gauge(300.0, None, Reach.OK)))[scale]).any()


def test_the_marker_goes_right_with_distance(painter: Painter) -> None:
    def marker(distance_mm: float) -> float:
        line = drawn(painter, replace(AIM, gauge=gauge(distance_mm)))[70, 200:500].min(axis=1)
        return float(np.argwhere(line > 200).mean())

    near, middle, far = (marker(mm) for mm in (460.0, 500.0, 540.0))
    assert near < middle < far
    assert middle - near == pytest.approx(far - middle, abs=2)


def test_aiming_is_drawn_at_twenty_pictures_a_second_at_least(painter: Painter) -> None:
    view = replace(AIM, gauge=gauge(512.0, 3.0), alerts=(LOST,))
    drawn(painter, view)
    took_s = []
    for number in range(10):
        begun = time.process_time()  # of all threads: what else the machine does is not asked
        painter.draw(view, 0.05 * number)
        took_s.append(time.process_time() - begun)
    assert min(took_s) < 0.05


# ----------------------------------------------------------------------------------- the others


def test_waiting_moves(painter: Painter) -> None:
    for view in (CheckView(), ReconstructView(), SavingView(scan_id="1", saved=False)):
        assert (drawn(painter, view, 0.0) != drawn(painter, view, 0.4)).any()


def test_saved_looks_unlike_saving(painter: Painter) -> None:
    saving, saved = (drawn(painter, SavingView(scan_id="000007", saved=saved)) for saved in (False, True))
    green = np.abs(saved.astype(int) - (91, 227, 138)).max(axis=2) < 10
    assert green.sum() > 5000
    assert (np.abs(saving.astype(int) - (91, 227, 138)).max(axis=2) < 10).sum() == 0


def test_a_bad_scan_does_not_look_like_a_good_one(painter: Painter) -> None:
    good, bad = (drawn(painter, replace(REVIEW, grade=grade))[72:138, 542:] for grade in (Grade.GOOD, Grade.BAD))
    assert bad.mean() > 1.5 * good.mean()  # seen in grey, at a glance


@pytest.mark.parametrize("grade", [Grade.GOOD, Grade.USABLE])
def test_a_grade_does_not_stand_alone_where_lengths_are_not_trusted(painter: Painter, grade: Grade) -> None:
    def heading(view: AnyView) -> tuple[set[str], float]:
        picture = drawn(painter, view)[68:134, 524:780].astype(int)
        amber = (np.abs(picture - (255, 210, 31)).max(axis=2) < 10).mean()
        return {line.words for line in painter.canvas.written}, float(amber)

    gallery = GalleryView(scan_id="000007", count=1, grade=grade)
    for view in (replace(REVIEW, grade=grade), gallery):
        trusted, doubtful = heading(view), heading(replace(view, lengths_doubtful=True))
        assert "LENGTHS UNSURE" not in trusted[0]
        assert "LENGTHS UNSURE" in doubtful[0]
        assert doubtful[1] > 0.5 > trusted[1]
    bad = heading(replace(REVIEW, grade=Grade.BAD, lengths_doubtful=True))
    assert "BAD" in bad[0]


def test_what_a_scan_would_fail_for_stands_where_ready_stood(painter: Painter) -> None:
    dark = Alert(FaultCode.AIM_DARK, Severity.WARNING, "TOO DARK TO SCAN", "GO CLOSER", passing=True)
    drawn(painter, replace(AIM, alerts=(dark,)))
    said = [line.words for line in painter.canvas.written]
    assert "READY" not in said
    assert said.count("TOO DARK TO SCAN") == 1
    assert "TOO DARK TO SCAN: GO CLOSER" in said
    drawn(painter, replace(AIM, alerts=(dark,), scan_allowed=False))
    assert "NOT READY" in [line.words for line in painter.canvas.written]


def test_the_key_that_acknowledges_is_as_yellow_as_the_warning_above_it(painter: Painter) -> None:
    view = replace(AIM, alerts=(LOST,), keys={Key.BACK: Text.SEEN})
    label = drawn(painter, view)[430:476, 700:780].astype(int)
    assert (np.abs(label - (255, 210, 31)).max(axis=2) < 10).mean() > 0.4


def test_a_preview_is_the_cloud_alone_whatever_lies_over_it(painter: Painter) -> None:
    drawn(painter, REVIEW, 0.0)
    alone = painter.preview()
    drawn(painter, replace(REVIEW, alerts=(LEAK,), turn=2, grade=Grade.BAD), 3.0)
    again = painter.preview()
    assert alone is not None
    assert again is not None
    np.testing.assert_array_equal(alone, again)
    assert alone.shape == (356, 512, 3)
    assert (alone.max(axis=2) > 40).mean() > 0.1
    assert (alone.min(axis=2) > 220).sum() == 0, "no letters, no labels"


def test_without_points_there_is_no_preview(painter: Painter) -> None:
    drawn(painter, replace(REVIEW, points_mm=POINTS[:0], values=POINTS[:0, 2].copy()))
    assert painter.preview() is None


def test_what_a_screen_is_about_is_not_said_twice(painter: Painter) -> None:
    plain = drawn(painter, SafeView(alert=LEAK, saved=True))
    np.testing.assert_array_equal(drawn(painter, SafeView(alert=LEAK, saved=True, alerts=(LEAK,))), plain)
    assert (drawn(painter, SafeView(alert=LEAK, saved=True, alerts=(LEAK, LOST))) != plain).any()
