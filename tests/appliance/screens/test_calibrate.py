"""What a diver sees while calibrating: what to hold, what became of it, what it gave."""

from __future__ import annotations

import moderngl
import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.calibration.guide import HELD, USED, AdjustmentSummary, RecordingCheck, Refusal, Session, Step, Verified
from appliance.calibration.poses import plane_place
from appliance.calibration.recordings import ArtefactKind
from appliance.machine.alerts import Alert, Severity
from appliance.machine.failure import Failure, FailureKind
from appliance.machine.states import Calibrating, Task
from appliance.machine.words import Language, Text
from appliance.optics.volume import STANDARD, WorkingVolume
from appliance.scan.fault import FaultCode
from appliance.screens import theme
from appliance.screens.calibrate import refusal_words
from appliance.screens.canvas import Canvas
from appliance.screens.painter import Painter
from appliance.screens.sketch import sketch_depth, sketch_front
from appliance.screens.views import CalibrateView

Picture = NDArray[np.uint8]
LIVE = np.full((300, 400), 90, np.uint8)
GOOD = tuple(RecordingCheck(step, None, 0.03, 2100) for step in USED)
SOLVED = AdjustmentSummary("bundle, spline", 0.034, (), "abc")
BETTER = Session(GOOD, SOLVED, Verified(0.0031, -0.0002, 0.00004))
BAND = slice(374, 426)
YELLOW, GREEN, AQUA = (255, 210, 31), (91, 227, 138), (63, 208, 232)


def drawn(painter: Painter, at: Calibrating, session: Session | None = None, time_s: float = 0.0) -> Picture:
    view = CalibrateView(at=at, session=session or Session(), left=LIVE, right=LIVE)
    return painter.draw(view, time_s).copy()


def share(picture: Picture, colour: tuple[int, int, int]) -> float:
    return float((np.abs(picture.astype(int) - colour).max(axis=2) < 12).mean())


@pytest.mark.parametrize("language", list(Language))
@pytest.mark.parametrize("step", list(Step))
def test_every_step_has_something_to_read_and_no_two_look_alike(
    context: moderngl.Context, step: Step, language: Language
) -> None:
    with Painter(context, (800, 480), language) as painter:
        picture = drawn(painter, Calibrating(step), BETTER)
        others = [drawn(painter, Calibrating(other), BETTER) for other in Step if other is not step]
    edges = np.abs(np.diff(picture.mean(axis=2), axis=1)) > 120
    assert edges.mean() > 0.002
    assert all((picture[:330] != other[:330]).any() for other in others)


@pytest.mark.parametrize("step", list(HELD))
def test_the_live_picture_is_shown_where_something_is_held(painter: Painter, step: Step) -> None:
    assert drawn(painter, Calibrating(step))[80:335, 445:780].mean() == pytest.approx(90, abs=2)


def test_a_refusal_is_yellow_an_acceptance_green_and_nothing_is_neither(painter: Painter) -> None:
    refused = drawn(painter, Calibrating(Step.M1, latest=RecordingCheck(Step.M1, Refusal.TILT_MORE, 12.0)))[BAND]
    fits = drawn(painter, Calibrating(Step.M2, latest=GOOD[0]))[BAND]
    nothing = drawn(painter, Calibrating(Step.M1))[BAND]
    assert share(refused, YELLOW) > 0.6
    assert share(fits, GREEN) > 0.6
    assert share(nothing, YELLOW) + share(nothing, GREEN) == 0.0


def test_each_refusal_has_words_of_its_own_and_they_fit(context: moderngl.Context) -> None:
    with context:
        canvas = Canvas(context, (800, 480))
        for step in HELD:
            said = set()
            for refusal in Refusal:
                what, why = refusal_words(RecordingCheck(step, refusal, 12.0))
                said.add(what)
                for language in Language:
                    assert canvas.measure(what.in_language(language), theme.BODY + 2, theme.BLACK) <= 300 / 0.8
                    assert canvas.measure(why.in_language(language), theme.CAPTION, theme.BOLD) <= 520
            assert len(said) == len(Refusal)
        canvas.close()


def test_distances_are_those_of_the_housing(painter: Painter) -> None:
    """The words and the sketch of a plane, the advice on one that is too far, and the scale while aiming."""
    small = WorkingVolume(264.0, 300.0, 336.0)
    far = Calibrating(Step.M3, latest=RecordingCheck(Step.M3, Refusal.TOO_FAR, 400.0))
    for at in (Calibrating(Step.M3), far):
        pictures = [
            painter.draw(CalibrateView(at=at, session=Session(), left=None, right=None, volume=volume), 0.0).copy()
            for volume in (STANDARD, WorkingVolume(), small)
        ]
        assert (pictures[0] == pictures[1]).all()
        assert (pictures[0] != pictures[2]).any()
    assert Text.PLANE_AWAY.filled(Language.ENGLISH, plane_place(Step.M3, small).wanted_mm).startswith("282 mm AWAY")
    place = plane_place(Step.M4, small)
    assert Text.RIGHT_RANGE.filled(Language.GERMAN, place.nearest_mm, place.farthest_mm) == "RICHTIG: 318 BIS 372 mm"


def test_a_missing_plane_is_not_called_a_missing_bar() -> None:
    words = {
        kind: {
            refusal_words(RecordingCheck(step, Refusal.NOT_FOUND, None)) for step, held in HELD.items() if held is kind
        }
        for kind in ArtefactKind
    }
    assert words[ArtefactKind.BALL_BAR].isdisjoint(words[ArtefactKind.PLANE])


def test_work_moves_and_solving_grows(painter: Painter) -> None:
    looking = Calibrating(Step.M1, Task.EXAMINE, 1)
    assert (drawn(painter, looking, time_s=0.0)[BAND] != drawn(painter, looking, time_s=0.4)[BAND]).any()
    early, later = (drawn(painter, Calibrating(Step.SOLVE, Task.SOLVE, progress=p), Session(GOOD)) for p in (0.2, 0.8))
    assert share(early[BAND], AQUA) < share(later[BAND], AQUA)


def test_ticks_say_which_steps_are_done(painter: Painter) -> None:
    greens = [share(drawn(painter, Calibrating(Step.M1), Session(GOOD[:k]))[430:, 200:600], GREEN) for k in range(5)]
    assert greens == sorted(greens)
    assert len(set(greens)) == 5


def test_the_result_marks_what_is_in_use_and_says_whether_it_is_better(painter: Painter) -> None:
    before, new = (slice(120, 310), slice(20, 390)), (slice(120, 310), slice(410, 780))
    old = drawn(painter, Calibrating(Step.RESULT), BETTER)
    kept = Session(GOOD, SOLVED, BETTER.verified, in_use=True, kept="0001-2026-11-21.json")
    used = drawn(painter, Calibrating(Step.RESULT), kept)
    assert share(old[before], AQUA) > 5 * share(old[new], AQUA)
    assert share(used[new], AQUA) > 5 * share(used[before], AQUA)
    worse = drawn(painter, Calibrating(Step.RESULT), Session(GOOD, SOLVED, Verified(0.0002, 0.004, 0.00004)))
    assert share(old[new], GREEN) > 0.003 > share(old[new], YELLOW)
    assert share(worse[new], YELLOW) > 0.003 > share(worse[new], GREEN)


def test_an_error_that_is_not_known_is_no_zero(painter: Painter) -> None:
    unknown, zero = (
        drawn(painter, Calibrating(Step.RESULT), Session(GOOD, SOLVED, Verified(before, 0.0001, 0.00004)))
        for before in (None, 0.0)
    )
    assert (unknown[120:310, 20:390] != zero[120:310, 20:390]).any()


# ---------------------------------------------------------------------------------------- sketches


def test_the_nearer_ball_is_drawn_larger_and_brighter() -> None:
    front = sketch_front(Step.M1).astype(int)
    left, right = front[:, :90], front[:, 90:]
    assert (right > 130).sum() > 1.1 * (left > 130).sum()
    assert right.max() > left.max() + 50
    level = sketch_front(Step.VERIFY).astype(int)
    assert (level[:, :90] > 130).sum() == pytest.approx((level[:, 90:] > 130).sum(), rel=0.1)


def test_the_upright_bar_stands_and_the_lying_bar_lies() -> None:
    for step, stands in ((Step.M1, False), (Step.M2, True)):
        v, u = np.nonzero(sketch_front(step) > 130)
        assert (np.ptp(v) > np.ptp(u)) == stands


def test_the_near_plane_is_drawn_nearer_to_the_instrument() -> None:
    def distance(step: Step) -> float:
        return float(np.nonzero(sketch_depth(step) > 200)[1].mean())

    assert distance(Step.M4) - distance(Step.M3) > 30.0
    assert (sketch_front(Step.M3) > 100).sum() > 1.2 * (sketch_front(Step.M4) > 100).sum()


def test_a_difference_that_may_be_chance_is_called_neither_better_nor_worse(painter: Painter) -> None:
    assert Verified(0.0031, -0.0002, 0.00004).better is True
    assert Verified(0.0002, 0.0031, 0.00004).better is False
    assert Verified(0.0002, -0.00015, 0.00004).better is None
    assert Verified(None, 0.0031, 0.00004).better is True, "nothing could be measured before"
    new = (slice(120, 310), slice(410, 780))
    picture = drawn(painter, Calibrating(Step.RESULT), Session(GOOD, SOLVED, Verified(0.0002, -0.00015, 0.00004)))
    assert share(picture[new], GREEN) == share(picture[new], YELLOW) == 0.0


def test_an_alert_does_not_hide_what_became_of_a_recording(painter: Painter) -> None:
    at = Calibrating(Step.M2, latest=GOOD[0])
    alone = drawn(painter, at)
    for severity in (Severity.WARNING, Severity.CRITICAL):
        alert = Alert(FaultCode.WARM, severity, "WARM 52 °C", "LET IT COOL SOON")
        view = CalibrateView(at=at, session=Session(), left=LIVE, right=LIVE, alerts=(alert,))
        assert share(painter.draw(view, 0.0), GREEN) == pytest.approx(share(alone, GREEN), rel=0.02)


@pytest.mark.parametrize("kind", list(FailureKind))
def test_what_came_to_nothing_is_told_in_the_language_of_the_screen_and_never_in_the_words_of_the_log(
    painter: Painter, kind: FailureKind
) -> None:
    known = [text.german for text in Text]
    at = Calibrating(Step.SOLVE, failed=Failure(kind, "M1, scan 000012: no ball on the right; record M1 again", "M1"))
    painter.language = Language.GERMAN
    try:
        drawn(painter, at, Session(GOOD))
        band = [line for line in painter.canvas.written if line.top > 480 - 62 - 84]
    finally:
        painter.language = Language.ENGLISH
    said = [line.words for line in band if line.words != "✓"]
    assert said[0] == Text.BAR_LYING.german, "of which step"
    assert len(said) == 3
    assert all(words in known for words in said[1:]), said
    assert not any(line.cut for line in band)


def test_each_mishap_has_words_of_its_own(painter: Painter) -> None:
    told = set()
    for kind in FailureKind:
        drawn(painter, Calibrating(Step.SOLVE, failed=Failure(kind, "")), Session(GOOD))
        told.add(tuple(line.words for line in painter.canvas.written if line.top > 480 - 62 - 84))
    assert len(told) == len(FailureKind)
