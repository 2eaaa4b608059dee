"""What a diver would notice on the screens beyond what their golden pictures show: what changes, moves, lasts, and what is left out."""

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
from appliance.calibrate.guide import HELD, USED, AdjustmentSummary, LengthCheck, RecordingCheck, Refusal, Session, Step
from appliance.calibrate.recordings import ArtefactKind
from appliance.calibrate.water_steps import plane_distance
from appliance.instrument.machine.alerts import Alert, Severity
from appliance.instrument.machine.states import Calibrating, Failure, FailureKind, State, Task
from appliance.instrument.machine.words import Label, Language, Text
from appliance.instrument.ranging.reach import Reach
from appliance.instrument.screens import theme, views
from appliance.instrument.screens.calibrate import refusal_text, sketch_depth, sketch_front
from appliance.instrument.screens.canvas import MAX_TEXTS, Canvas
from appliance.instrument.screens.painter import MOVES_HZ, Painter
from appliance.measure.fault import FaultCode
from appliance.measure.light.volume import STANDARD, WorkingVolume
from appliance.measure.verdict import Grade
from drivers.api import Key
from tests.appliance.instrument.screens.golden.scenes import SCENES

Picture = NDArray[np.uint8]
LEAK = Alert(FaultCode.LEAK, Severity.CRITICAL, "LEAK", "ASCEND")
LOST = Alert(FaultCode.CAMERA_LOST, Severity.WARNING, "RIGHT CAM LOST", "OFF AND ON, OR END DIVE")
NEWS = Alert(FaultCode.BOARD_RESET, Severity.INFO, "BOARD RESET", "NOTHING TO DO")
DIM = Alert(FaultCode.AIM_DARK, Severity.WARNING, "TOO DARK TO SCAN", "GO CLOSER", passing=True)
YELLOW, GREEN, AQUA = (255, 210, 31), (91, 227, 138), (63, 208, 232)
GREY = np.full((1200, 1600), 90, np.uint8)
KEYS = {Key.SCAN: Text.SCAN, Key.BACK: Text.HOLD_OFF}
AIM = views.AimView(left=GREY, right=GREY, scans_taken=12, scans_left=41, temperature_c=34.0, keys=KEYS)
POINTS = np.random.default_rng(2).uniform((-100, -80, 480), (100, 80, 520), (4000, 3)).astype(np.float32)
REVIEW = views.ReviewView(
    points_mm=POINTS, values=POINTS[:, 2].copy(), coarse=False, grade=Grade.GOOD, points=4000,
    coverage_percent=87.0, noise_mm=0.028, distance_mm=503.0, duration_s=0.8,
)  # fmt: skip


def drawn(painter: Painter, view: views.AnyView, time_s: float = 0.0) -> Picture:
    return painter.draw(view, time_s).copy()


def said(painter: Painter, view: views.AnyView) -> list[str]:
    painter.draw(view, 0.0)
    return [line.text for line in painter.canvas.written]


def share(picture: Picture, colour: tuple[int, int, int]) -> float:
    return float((np.abs(picture.astype(int) - colour).max(axis=2) < 12).mean())


@pytest.mark.parametrize("size_px", [(640, 480), (1024, 600), (1280, 800)])
def test_other_displays_are_filled_to_their_edges(context: moderngl.Context, size_px: tuple[int, int]) -> None:
    with Painter(context, size_px) as painter:
        picture = drawn(painter, AIM)
    assert picture.shape == (size_px[1], size_px[0], 3)
    assert (picture[2:20, -4:] > 100).any()  # the mark of the SCAN key at the upper right edge
    assert (picture[-20:-2, -4:] > 100).any()


def test_the_same_memory_is_used_each_time_and_new_numbers_do_not_fill_it(painter: Painter, canvas: Canvas) -> None:
    canvas.begin(theme.INK)
    for number in range(3 * MAX_TEXTS):
        canvas.write(f"{number} mm", (10, 100))
    assert len(canvas._texts) == MAX_TEXTS
    assert painter.draw(AIM, 0.0) is painter.draw(replace(AIM, scans_taken=13), 0.1)


def test_other_drawing_on_the_context_does_not_disturb(context: moderngl.Context, painter: Painter) -> None:
    before = drawn(painter, REVIEW)
    with context:
        canvas = context.simple_framebuffer((32, 32))
        canvas.use()
        context.disable(moderngl.BLEND)
        context.enable(moderngl.DEPTH_TEST)
        canvas.clear(1.0, 1.0, 1.0, 1.0)
    np.testing.assert_array_equal(drawn(painter, REVIEW), before)


def test_a_word_that_is_no_entry_of_the_table_is_not_translated(painter: Painter) -> None:
    painter.language = Language.GERMAN
    labels: dict[Key, Label] = {Key.SCAN: "KEEP", Key.BACK: Text.HOLD_REDO, Key.DOWN: (Text.HOLD_ADD, "0.5 ms")}
    written = " ".join(said(painter, replace(REVIEW, keys=labels)))
    assert all(words in written for words in ("KEEP", "HALTEN: NOCHMAL", "0,5 ms"))
    assert "BEHALTEN" not in written


def test_no_word_of_the_table_is_left_over() -> None:
    files = Path(appliance.__file__).parent.rglob("*.py")
    asked = {name for path in files for name in re.findall(r"\bText\.(\w+)", path.read_text(encoding="utf-8"))}
    assert not {text.name for text in Text} - asked


def test_what_waits_moves_and_what_a_screen_is_about_is_not_said_twice(painter: Painter) -> None:
    for view in (
        views.ProgressView(state=State.CHECK),
        views.ProgressView(state=State.RECONSTRUCT),
        views.SavingView(scan_id="1", saved=False),
    ):
        assert (drawn(painter, view, 0.0) != drawn(painter, view, 0.4)).any()
    plain = drawn(painter, views.SafeView(alert=LEAK, saved=True))
    np.testing.assert_array_equal(drawn(painter, views.SafeView(alert=LEAK, saved=True, alerts=(LEAK,))), plain)
    assert (drawn(painter, views.SafeView(alert=LEAK, saved=True, alerts=(LEAK, LOST))) != plain).any()


def test_aiming_is_drawn_at_twenty_pictures_a_second_at_least(painter: Painter) -> None:
    view = replace(AIM, gauge=views.Gauge(512.0, 3.0, Reach.OK), alerts=(LOST,))
    drawn(painter, view)
    took_s = []
    for number in range(10):
        begun = time.process_time()  # of all threads: what else the machine does is not asked
        painter.draw(view, 0.05 * number)
        took_s.append(time.process_time() - begun)
    assert min(took_s) < 0.05


def test_a_warning_stands_still_and_a_critical_alert_flashes_with_the_same_words(painter: Painter) -> None:
    halves = 0.0, 0.6 / theme.FLASH_HZ
    first, later = (drawn(painter, replace(AIM, alerts=(LOST,)), t) for t in halves)
    np.testing.assert_array_equal(first, later)
    bright, dark = (drawn(painter, replace(AIM, alerts=(LEAK,)), t) for t in halves)
    red_bright, red_dark = (((p[:, :, 0] > 140) & (p[:, :, 1] < 70)).mean() for p in (bright, dark))
    assert red_bright > 0.15 > 0.06 > red_dark
    white = [(p[280:418, 100:].min(axis=2) > 230) for p in (bright, dark)]
    assert white[0].sum() > 2000
    assert (white[0] == white[1]).mean() > 0.99


def test_flashing_stays_below_three_per_second() -> None:
    bright = [theme.flash_on(t / 1000) for t in range(10_000)]
    assert 10 <= sum(later and not earlier for earlier, later in pairwise(bright)) < 30


@pytest.mark.parametrize("alerts", [(LOST, LEAK), (NEWS, LOST, LEAK)])
def test_the_gravest_alert_wins_whatever_the_order(painter: Painter, alerts: tuple[Alert, ...]) -> None:
    first, other = (drawn(painter, replace(AIM, alerts=order)) for order in (alerts, alerts[::-1]))
    assert tuple(first[316, 797]) == tuple(other[316, 797]) == (0xFF, 0x3B, 0x3B)  # the edge of a critical one


def test_what_a_scan_would_fail_for_stands_where_ready_stood(painter: Painter) -> None:
    lines = said(painter, replace(AIM, alerts=(DIM,)))
    assert "READY" not in lines
    assert lines.count("TOO DARK TO SCAN") == lines.count("TOO DARK TO SCAN: GO CLOSER") == 1
    assert "NOT READY" in said(painter, replace(AIM, alerts=(DIM,), scan_allowed=False))


@pytest.mark.parametrize("grade", [Grade.GOOD, Grade.USABLE])
def test_a_grade_does_not_stand_alone_where_lengths_are_not_trusted(painter: Painter, grade: Grade) -> None:
    stored = views.StoredScan("000007", grade=grade)
    for certain, doubtful in (
        (replace(REVIEW, grade=grade), replace(REVIEW, grade=grade, lengths_doubtful=True)),
        tuple(views.GalleryView(scan=replace(stored, lengths_doubtful=one), count=1) for one in (False, True)),
    ):
        assert "LENGTHS UNSURE" not in said(painter, certain)
        assert "LENGTHS UNSURE" in said(painter, doubtful)
        assert share(drawn(painter, doubtful)[68:134, 524:780], YELLOW) > 0.5
    assert "BAD" in said(painter, replace(REVIEW, grade=Grade.BAD, lengths_doubtful=True))


def test_live_pictures_are_upright_on_their_own_side_and_never_old_ones(painter: Painter) -> None:
    left, right = (np.full((1200, 1600), 20, np.uint8) for _ in range(2))
    left[600:, :800], right[:600, 800:] = 200, 150  # the lower left quarter, and the upper right one
    picture = drawn(painter, replace(AIM, left=left, right=right))[:, :, 0].astype(int)
    places = {(350, 100): 200, (200, 300): 20, (200, 700): 150, (350, 500): 20}
    assert {at: picture[at] for at in places} == pytest.approx(places, abs=2)
    left[:] = 160  # in place
    picture = drawn(painter, replace(AIM, left=left, right=None))
    assert picture[300, 200, 0] == pytest.approx(160, abs=2)
    assert picture[170:410, 420:780].mean() < 40, "a lost camera leaves none behind"


def test_saturation_is_striped(painter: Painter) -> None:
    full, almost = (
        drawn(painter, replace(AIM, left=np.full_like(GREY, value)))[170:410, 60:380, 0] for value in (255, 245)
    )
    assert 0.2 < (full < 30).mean() < 0.6
    assert almost.min() > 240


def test_the_scale_is_that_of_the_housing(painter: Painter) -> None:
    """300 mm in a housing for 300 mm look as 500 mm do in one for 500 mm, but for the number."""
    small = WorkingVolume(264.0, 300.0, 336.0)

    def scale(distance_mm: float, volume: WorkingVolume) -> Picture:
        gauge = views.Gauge(distance_mm, None, Reach.OK, volume)
        return drawn(painter, replace(AIM, gauge=gauge))[64:118, 190:500]

    assert (scale(300.0, small) == scale(500.0, STANDARD)).all()
    marker = [np.argwhere(scale(mm, STANDARD)[6, 10:].min(axis=1) > 200).mean() for mm in (460.0, 500.0, 540.0)]
    assert marker[1] - marker[0] == pytest.approx(marker[2] - marker[1], abs=2)
    assert marker[1] > marker[0] + 10


def test_a_preview_is_the_cloud_alone_whatever_lies_over_it(painter: Painter) -> None:
    drawn(painter, REVIEW, 0.0)
    alone = painter.preview()
    drawn(painter, replace(REVIEW, alerts=(LEAK,), turn_steps=2, grade=Grade.BAD), 3.0)
    again = painter.preview()
    assert alone is not None
    assert again is not None
    np.testing.assert_array_equal(alone, again)
    assert alone.shape == (356, 512, 3)
    assert (alone.max(axis=2) > 40).mean() > 0.1
    assert (alone.min(axis=2) > 220).sum() == 0, "no letters, no labels"
    drawn(painter, replace(REVIEW, points_mm=POINTS[:0], values=POINTS[:0, 2].copy()))
    assert painter.preview() is None


def test_a_screen_is_drawn_anew_as_soon_as_anything_on_it_is_and_not_before(context: moderngl.Context) -> None:
    flashing, half_s = replace(AIM, alerts=(LEAK,)), 0.5 / theme.FLASH_HZ
    moving: list[tuple[views.AnyView, views.AnyView, float, bool]] = [
        (AIM, replace(AIM), 1000.0, False), (REVIEW, REVIEW, 0.9 / MOVES_HZ, False), (REVIEW, REVIEW, 1.1 / MOVES_HZ, True),
        (flashing, flashing, 0.9 * half_s, False), (flashing, flashing, 1.1 * half_s, True),
    ]  # fmt: skip
    changes = [
        {"left": GREY.copy()}, {"right": None}, {"scans_taken": 13}, {"temperature_c": None}, {"exposure": "12 ms"}, {"object": 3},
        {"alerts": (NEWS,)}, {"keys": {}},
    ]  # fmt: skip
    changed = [(AIM, replace(AIM, **change), 0.0, True) for change in changes]  # type: ignore[arg-type]
    with Painter(context, (400, 240)) as painter:
        for before, view, time_s, anew in (*moving, *changed):
            painter.draw(AIM if before is REVIEW else REVIEW, 0.0)
            painter.draw(before, 0.0)[:] = 7
            assert (not (painter.draw(view, time_s) == 7).all()) == anew, (view, time_s)
        painter.draw(AIM, 0.0)[:] = 7
        painter.language = Language.GERMAN
        assert not (painter.draw(AIM, 0.0) == 7).all(), "other words"
        review = painter.draw(REVIEW, 0.0).copy()
        assert painter.preview() is not None
        np.testing.assert_array_equal(painter.draw(REVIEW, 0.0), review)


def test_whatever_stood_there_before_the_picture_is_that_of_the_view(context: moderngl.Context) -> None:
    with Painter(context, (400, 240)) as painter, Painter(context, (400, 240)) as other:
        for scene in (*SCENES.values(), *list(SCENES.values())[::-3]):
            got = painter.draw(scene.view, 0.3)
            other.draw(views.SavingView(scan_id="1", saved=False), 0.0)
            np.testing.assert_array_equal(got, other.draw(scene.view, 0.3))


USUAL = tuple(RecordingCheck(step, None, 0.03, 2100) for step in USED)
SOLVED = AdjustmentSummary("bundle, spline", 0.034, (), "abc")
SMALL = WorkingVolume(264.0, 300.0, 336.0)
IN_USE, NEW = (slice(120, 310), slice(20, 390)), (slice(120, 310), slice(410, 780))
BAND = slice(374, 426)


def step_of(at: Calibrating, session: Session | None = None, volume: WorkingVolume = STANDARD) -> views.CalibrateView:
    return views.CalibrateView(position=at, session=session or Session(), left=GREY, right=GREY, volume=volume)


def result(*verified: float | None, kept: str | None = None) -> views.CalibrateView:
    before, now = verified
    session = Session(USUAL, SOLVED, LengthCheck(before, now, 0.00004), kept is not None, kept)
    return step_of(Calibrating(Step.RESULT), session)


def test_no_two_steps_look_alike_and_the_live_picture_is_shown_where_something_is_held(painter: Painter) -> None:
    session = Session(USUAL, SOLVED, LengthCheck(0.0031, -0.0002, 0.00004))
    pictures = [drawn(painter, step_of(Calibrating(step), session)) for step in Step]
    assert len({picture[:330].tobytes() for picture in pictures}) == len(Step)
    for step, picture in zip(Step, pictures, strict=True):
        assert (abs(picture[80:335, 445:780].mean() - 90) < 2) == (step in HELD)


def test_each_refusal_and_each_mishap_has_words_of_its_own(painter: Painter, canvas: Canvas) -> None:
    for step in HELD:
        words = [refusal_text(RecordingCheck(step, refusal, 12.0)) for refusal in Refusal]
        assert len({what for what, _ in words}) == len(Refusal)
        for (what, why), language in ((one, language) for one in words for language in Language):
            assert canvas.measure(what.in_language(language), theme.BODY + 2, theme.BLACK) <= 300 / 0.8
            assert canvas.measure(why.in_language(language), theme.CAPTION, theme.BOLD) <= 520
    of_kind = {
        kind: {refusal_text(RecordingCheck(step, Refusal.NOT_FOUND, None)) for step, held in HELD.items() if held is kind}
        for kind in ArtefactKind
    }  # fmt: skip
    assert of_kind[ArtefactKind.BALL_BAR].isdisjoint(of_kind[ArtefactKind.PLANE]), "a plane is not called a bar"
    painter.language, told = Language.GERMAN, set()
    for kind in FailureKind:
        failed = Failure(kind, "M1, scan 000012: no ball on the right; record M1 again", "M1")
        painter.draw(step_of(Calibrating(Step.SOLVE, failed=failed), Session(USUAL)), 0.0)
        band = [line for line in painter.canvas.written if line.top > 480 - 62 - 84 and line.text != "✓"]
        assert not any(line.cut for line in band)
        first, *others = (line.text for line in band)
        assert first == Text.BAR_LYING.german, "of which step, and never in the words of the log"
        assert all(words in [text.german for text in Text] for words in others)
        told.add(tuple(others))
    assert len(told) == len(FailureKind)


def test_distances_are_those_of_the_housing(painter: Painter) -> None:
    far = Calibrating(Step.M3, latest=RecordingCheck(Step.M3, Refusal.TOO_FAR, 400.0))
    for at in (Calibrating(Step.M3), far):
        usual, same, small = (drawn(painter, step_of(at, None, v)) for v in (STANDARD, WorkingVolume(), SMALL))
        assert (usual == same).all()
        assert (usual != small).any()
    assert Text.PLANE_AWAY.filled(Language.ENGLISH, plane_distance(Step.M3, SMALL).nominal_mm).startswith("282 mm")
    place = plane_distance(Step.M4, SMALL)
    assert "318 BIS 372 mm" in Text.RIGHT_RANGE.filled(Language.GERMAN, place.nearest_mm, place.farthest_mm)


def test_work_moves_solving_grows_and_ticks_say_which_steps_are_done(painter: Painter) -> None:
    looking = step_of(Calibrating(Step.M1, Task.EXAMINE, 1))
    assert (drawn(painter, looking)[BAND] != drawn(painter, looking, 0.4)[BAND]).any()
    solving = [step_of(Calibrating(Step.SOLVE, Task.SOLVE, progress=p), Session(USUAL)) for p in (0.2, 0.8)]
    early, later = (share(drawn(painter, one)[BAND], AQUA) for one in solving)
    assert early < later
    ticked = [step_of(Calibrating(Step.M1), Session(USUAL[:k])) for k in range(5)]
    greens = [share(drawn(painter, one)[430:, 200:600], GREEN) for one in ticked]
    assert greens == sorted(set(greens))


def test_the_result_marks_what_is_in_use_and_says_whether_it_is_better(painter: Painter) -> None:
    better, used = drawn(painter, result(0.0031, -0.0002)), drawn(painter, result(0.0031, -0.0002, kept="0001.json"))
    assert share(better[IN_USE], AQUA) > 5 * share(better[NEW], AQUA)
    assert share(used[NEW], AQUA) > 5 * share(used[IN_USE], AQUA)
    worse, chance = drawn(painter, result(0.0002, 0.004)), drawn(painter, result(0.0002, -0.00015))
    found = [(share(one[NEW], GREEN) > 0.003, share(one[NEW], YELLOW) > 0.003) for one in (better, worse, chance)]
    assert found == [(True, False), (False, True), (False, False)]
    verified = [(0.0031, -0.0002), (0.0002, 0.0031), (0.0002, -0.00015), (None, 0.0031)]
    assert [LengthCheck(*one, 0.00004).better for one in verified] == [True, False, None, True], (
        "unknown before is no zero"
    )
    assert (drawn(painter, result(None, 0.0001))[IN_USE] != drawn(painter, result(0.0, 0.0001))[IN_USE]).any()


def test_sketches_show_how_an_artefact_is_held() -> None:
    right, left = (half.astype(int) for half in np.hsplit(sketch_front(Step.M1), [90])[::-1])
    assert (right > 130).sum() > 1.1 * (left > 130).sum()
    assert right.max() > left.max() + 50
    for step, stands in ((Step.M1, False), (Step.M2, True)):
        v, u = np.nonzero(sketch_front(step) > 130)
        assert (np.ptp(v) > np.ptp(u)) == stands
    near, far = (float(np.nonzero(sketch_depth(step) > 200)[1].mean()) for step in (Step.M3, Step.M4))
    assert far - near > 30.0
    assert (sketch_front(Step.M3) > 100).sum() > 1.2 * (sketch_front(Step.M4) > 100).sum()
