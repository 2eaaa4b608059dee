"""Screens of the calibration in water: a step that records, the adjustment, and its result.

draw_calibrate                the screen of the state
sketch_front, sketch_depth    pose of an artefact: as the instrument sees it, and from above or from the side
refusal_text                  text about a recording that cannot be used
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import assert_never

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.calibrate import (
    HELD,
    STEPS,
    UNITS,
    USED,
    ArtefactKind,
    LengthCheck,
    RecordingCheck,
    Refusal,
    Session,
    Step,
    plane_distance,
)
from appliance.instrument.machine.states import FailureKind, Task
from appliance.instrument.machine.words import STEP_NAMES, Label, Text
from appliance.instrument.screens import theme
from appliance.instrument.screens.canvas import Align, Canvas
from appliance.instrument.screens.frame import alerts_top, draw_title
from appliance.instrument.screens.laser_marks import draw_marks
from appliance.instrument.screens.theme import BLACK, BODY, BOLD, CAPTION, HUGE, REGULAR, TITLE
from appliance.instrument.screens.views import CalibrateView
from appliance.measure import STANDARD, STANDARD_MM, WorkingVolume

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

SIZE_PX = (180, 180)
SCALE = 2
"""Factor by which sketches are drawn larger and then reduced, for smooth lines."""
BALL_MM, HALF_BAR_MM = 15.0, 75.0
PLANE_MM = (125.0, 100.0)
FIELD_MM = 265.0
"""Width in mm of the sketch at the working distance: the instrument's field and a margin."""
_INK, _LINE, _SOFT, _BODY, _BRIGHT = 14, 70, 44, 150, 235
_POSES: Mapping[Step, tuple[float, float, float, float]] = MappingProxyType(
    {
        Step.M1: (505.0, 0.0, 35.0, 12.0),
        Step.M2: (515.0, 0.0, -35.0, 90.0),
        Step.M3: (plane_distance(Step.M3, STANDARD).nominal_mm, 10.0, 0.0, 0.0),
        Step.M4: (plane_distance(Step.M4, STANDARD).nominal_mm, -10.0, 0.0, 0.0),
        Step.VERIFY: (515.0, 0.0, 0.0, -45.0),
    }
)
"""Distance in mm before the standard housing, and rotations about x, y, z in degrees, one after the other."""
FROM_THE_SIDE = frozenset({Step.M2, Step.M3, Step.M4})
"""Steps whose tilt in depth is shown from the side; that of the others from above."""


def sketch_front(step: Step) -> Picture:
    """Return a sketch (h, w) uint8 as the instrument sees the artefact. ``step`` is one that records."""
    points, radii = _shape(step)
    # Pinhole: an object of FIELD_MM at the working distance is as wide as the sketch.
    focal = SCALE * SIZE_PX[0] * STANDARD_MM / FIELD_MM
    middle = 0.5 * SCALE * np.array(SIZE_PX)
    pixels = middle + focal * points[:, :2] / points[:, 2:]
    picture = _empty()
    if HELD[step] is ArtefactKind.PLANE:
        _face(picture, pixels)
    else:
        order = np.argsort(-points[:, 2])  # the farther ball first
        _bar(
            picture,
            pixels,
            focal * radii / points[:, 2],
            [_BRIGHT if p[2] <= points[:, 2].min() + 5.0 else _BODY for p in points],
            order,
        )
    return _reduced(picture)


def sketch_depth(step: Step, volume: WorkingVolume = STANDARD) -> Picture:
    """Return a sketch (h, w) uint8 from above or from the side: the instrument on the left, water right."""
    points, radii = _shape(step)
    across = points[:, 1] if step in FROM_THE_SIDE else points[:, 0]
    scale = SCALE * SIZE_PX[0] / 360.0
    pixels = np.stack([(points[:, 2] - 300.0) * scale, 0.5 * SCALE * SIZE_PX[1] + across * scale], -1)
    picture = _empty()
    # Drawn for the standard housing; a smaller one has smaller artefacts, so that the drawing is the same.
    ends_mm = (mm * STANDARD_MM / volume.working_mm for mm in (volume.nearest_mm, volume.farthest_mm))
    near, far = (round((mm - 300.0) * scale) for mm in ends_mm)
    cv2.rectangle(picture, (near, 20 * SCALE), (far, (SIZE_PX[1] - 20) * SCALE), (_SOFT,), -1)
    middle = SCALE * SIZE_PX[1] // 2
    cv2.rectangle(picture, (0, middle - 26 * SCALE), (16 * SCALE, middle + 26 * SCALE), (_BODY,), -1)
    cv2.line(picture, (16 * SCALE, middle), (SCALE * SIZE_PX[0], middle), (_LINE,), SCALE, cv2.LINE_AA)
    if HELD[step] is ArtefactKind.PLANE:
        ends = pixels[[0, 2]]
        cv2.line(picture, _pixel(ends[0]), _pixel(ends[1]), (_BRIGHT,), 6 * SCALE, cv2.LINE_AA)
    else:
        _bar(picture, pixels, radii * scale, [_BRIGHT, _BRIGHT], np.array([0, 1]))
    return _reduced(picture)


def _shape(step: Step) -> tuple[Array, Array]:
    """Return corners (4, 3) of the plane or centres (2, 3) of the balls in the rig frame, and ball radii."""
    distance, *angles = _POSES[step]
    if HELD[step] is ArtefactKind.PLANE:
        x, y = PLANE_MM
        local = np.array([[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]])
    else:
        local = np.array([[-HALF_BAR_MM, 0.0, 0.0], [HALF_BAR_MM, 0.0, 0.0]])
    for axis, degrees in enumerate(angles):
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        # The plane of each rotation in the order that keeps it right-handed: y-z, z-x, x-y.
        i, j = ((1, 2), (2, 0), (0, 1))[axis]
        rotation = np.eye(3)
        rotation[i, i] = rotation[j, j] = c
        rotation[i, j], rotation[j, i] = -s, s
        local = local @ rotation.T
    return local + np.array([0.0, 0.0, distance]), np.full(len(local), BALL_MM)


def _empty() -> Picture:
    return np.full((SCALE * SIZE_PX[1], SCALE * SIZE_PX[0]), _INK, np.uint8)


def _face(picture: Picture, corners: Array) -> None:
    outline = np.rint(corners).astype(np.int32)
    cv2.fillConvexPoly(picture, outline, (_BODY,), cv2.LINE_AA)
    cv2.polylines(picture, [outline], True, (_BRIGHT,), 2 * SCALE, cv2.LINE_AA)


def _bar(picture: Picture, centres: Array, radii: Array, greys: list[int], order: NDArray[np.intp]) -> None:
    cv2.line(picture, _pixel(centres[0]), _pixel(centres[1]), (_LINE + 20,), 5 * SCALE, cv2.LINE_AA)
    for k in order:
        cv2.circle(picture, _pixel(centres[k]), round(float(radii[k])), (greys[k],), -1, cv2.LINE_AA)


def _pixel(position: Array) -> tuple[int, int]:
    return round(float(position[0])), round(float(position[1]))


def _reduced(picture: Picture) -> Picture:
    return np.asarray(cv2.resize(picture, SIZE_PX, interpolation=cv2.INTER_AREA), np.uint8)


_TOP_PX, _SKETCH_PX = 68.0, 180.0
_LIVE_PX = (364.0, 273.0)
_WORDS_PX = 392.0
_BOX_PX = 370.0
_BAND_PX, _WORKING_PX = 84.0, 52.0
"""Heights of the band with a result and a remedy, and of one line."""
_TICKS_PX = 24.0
"""Distance of the marks' middle from the lower edge, in units of the design."""

_HOLD = {
    Step.M1: (Text.LYING, Text.FROM_ABOVE),
    Step.M2: (Text.UPRIGHT, Text.FROM_THE_SIDE),
    Step.M3: (Text.PLANE_AWAY, Text.FROM_THE_SIDE),
    Step.M4: (Text.PLANE_AWAY, Text.FROM_THE_SIDE),
    Step.VERIFY: (Text.LEVEL, Text.FROM_ABOVE),
}
_VERDICTS = {
    True: (Text.BETTER, theme.GREEN),
    None: (Text.NO_DIFFERENCE, theme.WHITE),
    False: (Text.WORSE, theme.YELLOW),
}
_TASKS = {
    Task.STORE: Text.STORING,
    Task.EXAMINE: Text.LOOKING,
    Task.ACCEPT: Text.ENTERING,
    Task.SOLVE: Text.SOLVING,
    Task.SWITCH: Text.SWITCHING,
}


def draw_calibrate(canvas: Canvas, view: CalibrateView, time_s: float) -> None:
    name = STEP_NAMES[view.step]
    draw_title(canvas, (name, "", Text.BALL_BAR) if view.step is Step.VERIFY else name, view.keys)
    # From bottom to top: an alert, the result of the recording, and sketches and image in the remaining space.
    bottom = alerts_top(canvas, view.alerts) + (-4 if view.alerts else 8)
    free = bottom - _latest_px(view)
    if view.step in HELD:
        _how(canvas, view, free)
        _live(canvas, view, free)
    elif view.step is Step.SOLVE:
        _solve(canvas, view, free)
    else:
        _result(canvas, view, free)
    _latest(canvas, view, bottom, time_s)
    _ticks(canvas, view)


def _latest_px(view: CalibrateView) -> float:
    """Return the height of the band at the lower end of the screen."""
    check = view.position.latest or view.session.check(view.step)
    if view.position.task is not None:
        return _WORKING_PX
    if view.position.failed is not None or check is not None:
        return _BAND_PX
    return 36.0 if view.step is Step.SOLVE else 0.0


_FAILURES = {
    FailureKind.RECORDING: (Text.NOT_USABLE, Text.RECORD_AGAIN),
    FailureKind.CERTIFICATE: (Text.NO_CERTIFICATE, Text.AT_THE_DESK),
    FailureKind.CAMERAS: (Text.OTHER_CAMERAS, Text.CALIBRATE_IN_AIR),
    FailureKind.NO_SOLUTION: (Text.NO_SOLUTION, Text.RECORD_ALL),
    FailureKind.FILES: (Text.FILES_DO_NOT_FIT, Text.AT_THE_DESK),
    FailureKind.DISK: (Text.DISK_REFUSED, Text.TRY_AGAIN),
    FailureKind.BROKEN_OFF: (Text.BROKEN_OFF, Text.TRY_AGAIN),
    FailureKind.NO_ANSWER: (Text.ANSWERED_LATE, Text.TRY_AGAIN),
}
"""Texts for each failure: the fault and the remedy. The details are in the log and in the status file."""


def _step_name(step_name: str) -> Label:
    """Return the name of a failure's step; empty if it names none."""
    return next((name for step, name in STEP_NAMES.items() if step.value == step_name), step_name)


def refusal_text(check: RecordingCheck) -> tuple[Text, Text]:
    """Return the texts about a recording that was refused: the fault, and the remedy or the right value."""
    bar = HELD[check.step] is ArtefactKind.BALL_BAR
    match check.refusal:
        case None:
            return Text.ACCEPTED, Text.ACCEPTED
        case Refusal.NOT_FOUND:
            return (Text.NO_BAR, Text.BOTH_BALLS_LIT) if bar else (Text.NO_PLANE, Text.ONLY_THE_PLANE)
        case Refusal.FEW_POINTS:
            return Text.FEW_POINTS, Text.WIPE_AND_SHOW
        case Refusal.BAD_FIT:
            return Text.BAD_FIT, Text.STILL_AND_CLEAN
        case Refusal.WRONG_SIZE:
            return Text.WRONG_SIZE, Text.SEE_CERTIFICATE
        case Refusal.LAY_DOWN:
            return Text.LAY_DOWN, Text.AGAINST_LEVEL
        case Refusal.STAND_UP:
            return Text.STAND_UP, Text.AGAINST_LEVEL
        case Refusal.TILT_MORE:
            return Text.TILT_MORE, Text.IN_DEPTH_20_50
        case Refusal.TILT_LESS:
            # VERIFY wants the bar level: M1 and M2, from which lengths are learned, have theirs tilted in depth.
            right = Text.IN_DEPTH_15 if check.step is Step.VERIFY else Text.IN_DEPTH_20_50 if bar else Text.PLANE_35
            return Text.TILT_LESS, right
        case Refusal.TOO_NEAR | Refusal.TOO_FAR:
            what = Text.TOO_NEAR if check.refusal is Refusal.TOO_NEAR else Text.TOO_FAR
            return what, Text.RIGHT_RANGE
        case Refusal.NOT_FILLED:
            return Text.NOT_FILLED, Text.FILL_45
        case Refusal.MOVED:
            return Text.MOVED, Text.STILL_AND_AGAIN
        case Refusal.WRONG_PATTERN:
            return Text.WRONG_PATTERN, Text.RECORD_AGAIN
        case unknown:
            assert_never(unknown)


def _how(canvas: Canvas, view: CalibrateView, bottom: float) -> None:
    """Draw two sketches side by side, and the instruction in words; smaller if there is little space."""
    step = view.step
    instruction, depth = _HOLD[step]
    # 92 px are the caption below the sketches and two lines of words.
    size = min(_SKETCH_PX, bottom - _TOP_PX - 92.0)
    for slot, picture, left, caption in (
        ("sketch.front", sketch_front(step), 8.0, Text.FRONT),
        ("sketch.depth", sketch_depth(step, view.volume), 204.0, depth),
    ):
        canvas.image(slot, picture, left, _TOP_PX, _SKETCH_PX, size)
        canvas.write(
            caption,
            (left + _SKETCH_PX / 2, _TOP_PX + size + 22),
            CAPTION,
            REGULAR,
            theme.MUTED,
            Align.CENTRE,
            _SKETCH_PX,
        )
    # Texts and drawings come from two tables, which must agree.
    assert (depth is Text.FROM_THE_SIDE) == (step in FROM_THE_SIDE)
    numbers = (plane_distance(step, view.volume).nominal_mm,) if HELD[step] is ArtefactKind.PLANE else ()
    lines = instruction.filled(canvas.language, *numbers).split(", ")
    for number, line in enumerate(lines):
        canvas.write(
            line,
            (_WORDS_PX / 2, _TOP_PX + size + 52 + 33 * number),
            BODY,
            BOLD,
            align=Align.CENTRE,
            max_width=_WORDS_PX - 16,
        )


def _live(canvas: Canvas, view: CalibrateView, bottom: float) -> None:
    """Draw the left camera's image, with the laser dots' marks, and the distance."""
    pixels, gauge = view.left, view.gauge
    width, height = _LIVE_PX[0], min(_LIVE_PX[1], bottom - _TOP_PX)
    left = canvas.width - width
    if pixels is not None:
        canvas.image("left", pixels, left, _TOP_PX, width, height)
        distance_mm = None if gauge is None else gauge.distance_mm
        if view.marks is not None:
            draw_marks(canvas, view.marks.left, pixels, left, _TOP_PX, width, height, distance_mm is not None)
        if gauge is not None:
            is_measured = distance_mm is not None
            text = f"{distance_mm:.0f} mm" if is_measured else Text.DOT_ON_IT
            wide = canvas.measure(text, CAPTION + 2, BLACK) + 20
            canvas.box(left + 10, _TOP_PX + 10, wide, 42, theme.INK, 10)
            ink = theme.WHITE if is_measured else theme.YELLOW
            canvas.write(text, (left + 20, _TOP_PX + 41), CAPTION + 2, BLACK, ink)
        return
    canvas.box(canvas.width - width, _TOP_PX, width, height, theme.DEEP, 10, (theme.YELLOW, 4))
    canvas.write(
        Text.NO_IMAGE,
        (canvas.width - width / 2, _TOP_PX + height / 2),
        TITLE,
        BLACK,
        theme.YELLOW,
        Align.CENTRE,
    )


def _latest(canvas: Canvas, view: CalibrateView, bottom: float, time_s: float) -> None:
    """Draw the band over the lower labels, or over an alert: the current task, or the latest result."""
    position = view.position
    # The recording of this visit, else that of the session, perhaps from before a restart.
    check = position.latest or view.session.check(view.step)
    if position.task is not None:
        _working(canvas, position.task, position.progress, time_s, bottom)
    elif position.failed is not None:
        came, remedy = _FAILURES[position.failed.kind]
        _band(canvas, theme.YELLOW, came, remedy, _step_name(position.failed.step_name), bottom)
    elif check is not None and check.refusal is None:
        number = "" if check.number is None else f"{1000.0 * check.number:.0f} µm"
        what = (STEP_NAMES[check.step], Text.ACCEPTED)
        _band(canvas, theme.GREEN, what, (str(check.points), Text.POINTS), number, bottom)
    elif check is not None and check.refusal is not None:
        refusal, why = refusal_text(check)
        # An angle is written without the space that SI puts before other units.
        number = "" if check.number is None else f"{check.number:.3g} {UNITS[check.refusal]}".replace(" °", "°")
        numbers: tuple[float, ...] = ()
        if why is Text.RIGHT_RANGE:
            place = plane_distance(check.step, view.volume)
            numbers = (place.nearest_mm, place.farthest_mm)
        _band(canvas, theme.YELLOW, refusal, why.filled(canvas.language, *numbers), number, bottom)
    elif view.step is Step.SOLVE:
        canvas.write(Text.SOME_SECONDS, (canvas.width / 2, bottom - 16), CAPTION, REGULAR, theme.MUTED, Align.CENTRE)


def _band(canvas: Canvas, fill: theme.Colour, what: Label, why: Label, number: Label, bottom: float) -> None:
    top, ink = bottom - _BAND_PX, theme.INK
    canvas.box(0, top, canvas.width, _BAND_PX, fill)
    right = canvas.width - 16
    if number:
        right -= canvas.write(number, (right, top + 39), TITLE - 4, BLACK, ink, Align.RIGHT) + 18
    canvas.write(what, (16, top + 39), TITLE - 4, BLACK, ink, max_width=right - 16)
    canvas.write(why, (16, top + 72), CAPTION + 2, BOLD, ink, max_width=canvas.width - 32)


def _working(canvas: Canvas, task: Task, progress: float | None, time_s: float, bottom: float) -> None:
    top = bottom - _WORKING_PX
    canvas.box(0, top, canvas.width, _WORKING_PX, theme.INK)
    canvas.write(_TASKS[task], (16, top + 38), BODY, BLACK, max_width=300)
    left, width = 330.0, canvas.width - 346.0
    canvas.box(left, top + 12, width, 28, theme.PANEL, 14)
    if progress is not None:
        canvas.box(left, top + 12, max(28.0, width * min(1.0, progress)), 28, theme.AQUA, 14)
    else:  # an animation without a length, since the progress is not known
        swing = 1.0 - abs(2.0 * (0.4 * time_s % 1.0) - 1.0)
        canvas.box(left + (width - 120.0) * swing, top + 12, 120, 28, theme.AQUA, 14)


def _solve(canvas: Canvas, view: CalibrateView, bottom: float) -> None:
    middle, room = canvas.width / 2, bottom - _TOP_PX
    top = _TOP_PX
    if view.position.failed is None:
        top, low, size = (top + 84.0, 24.0, TITLE) if room > 240 else (top + 38.0, 7.0, TITLE - 6)
        canvas.write(Text.FOUR_READY, (middle, top - low), size, BLACK, align=Align.CENTRE, max_width=760)
    # Rows move together if an alert needs space; all four stay, since the diver compares them.
    pitch = min(40.0, (bottom - top - 4) / len(USED))
    size = BODY if pitch > 34 else CAPTION
    for row, step in enumerate(USED):
        check = view.session.check(step)
        if check is None:
            continue
        baseline = top + pitch * (row + 0.75)
        canvas.write(STEP_NAMES[step], (120, baseline), size, BOLD)
        canvas.write(
            (str(check.points), Text.POINTS),
            (560, baseline),
            CAPTION,
            REGULAR,
            theme.MUTED,
            Align.RIGHT,
        )
        if check.number is not None:
            canvas.write(f"{1000.0 * check.number:.0f} µm", (690, baseline), size, BOLD, align=Align.RIGHT)


@dataclass(frozen=True, slots=True)
class _Box:
    """Box of a length error, as high as the space allows."""

    left: float
    top: float
    height: float
    is_in_use: bool
    """True if this calibration is the one in use."""

    def draw(self, canvas: Canvas, name: Text, error: float | None) -> None:
        """Draw the name above, the error in percent in the middle."""
        edge, width = (theme.AQUA, 6) if self.is_in_use else (theme.LINE, 3)
        canvas.box(self.left, self.top, _BOX_PX, self.height, theme.DEEP, 20, (edge, width))
        canvas.write(name, (self.left + 24, self.name_at), BODY, BLACK, theme.MUTED)
        text = "—" if error is None else f"{100.0 * abs(error):.3f} %"
        # 76 units are the lines of name and verdict, between which the number stands.
        size = round(min(HUGE - 18.0, 0.8 * (self.height - 76)))
        # Digits are 0.72 of the type size high: their baseline is half of that below the middle.
        level = 0.5 * (self.name_at + self.verdict_at - 26) + 0.36 * size
        canvas.write(text, (self.left + _BOX_PX / 2, level), size, BLACK, align=Align.CENTRE, max_width=340)

    def judge(self, canvas: Canvas, word: Text, colour: theme.Colour, verified: LengthCheck | None) -> None:
        """Draw the verdict in a word, and its standard uncertainty."""
        canvas.write(word, (self.left + 24, self.verdict_at), BODY, BLACK, colour)
        if verified is not None:
            canvas.write(
                f"± {100.0 * verified.sigma:.3f} %",
                (self.left + 346, self.verdict_at),
                CAPTION,
                BOLD,
                theme.MUTED,
                Align.RIGHT,
            )

    @property
    def name_at(self) -> float:
        """Baseline of the name."""
        return self.top + min(44.0, 0.2 * self.height + 8)

    @property
    def verdict_at(self) -> float:
        """Baseline of the verdict."""
        return self.top + self.height - 14


def _result(canvas: Canvas, view: CalibrateView, bottom: float) -> None:
    session = view.session
    top = _TOP_PX + 34
    height = min(190.0, bottom - top - 34)
    below = top + height + 27
    canvas.write(Text.LENGTH_ERROR, (canvas.width / 2, top - 9), BODY, BOLD, theme.MUTED, Align.CENTRE)
    verified = session.verified
    # Without a solved calibration the bar has checked the one in use, and there is no comparison.
    if verified is not None and verified.after is None:
        _checked(canvas, session, _Box(215.0, top, height, is_in_use=True), below)
        return
    before = None if verified is None else verified.before
    new = None if verified is None else verified.after
    # Before on the left, new on the right: the edge marks the one in use, and nothing moves when it changes.
    boxes = _Box(20.0, top, height, not session.in_use), _Box(410.0, top, height, session.in_use)
    for box, name, value in zip(boxes, (Text.BEFORE, Text.NEW), (before, new), strict=True):
        box.draw(canvas, name, value)
        if box.is_in_use:
            canvas.write(Text.IN_USE, (box.left + 346, box.name_at), CAPTION, BOLD, theme.AQUA, Align.RIGHT)
    if verified is not None:
        verdict, colour = _VERDICTS[verified.better]
        boxes[1].judge(canvas, verdict, colour, verified)
    if session.solved is not None:
        canvas.write((Text.RESIDUAL, f"{session.solved.residual_px:.3f} px"), (20, below), CAPTION, BOLD, max_width=370)
        if session.solved.warnings:
            canvas.write(
                f"{canvas.translate(Text.WARNINGS)}: {len(session.solved.warnings)}",
                (canvas.width - 20, below),
                CAPTION,
                BOLD,
                theme.YELLOW,
                Align.RIGHT,
                370,
            )


def _checked(canvas: Canvas, session: Session, box: _Box, below: float) -> None:
    """Draw the length error of the calibration in use, which the bar only checks."""
    box.draw(canvas, Text.IN_USE, session.length_error)
    word, colour = (Text.NOT_RIGHT, theme.YELLOW) if session.wrong else (Text.RIGHT, theme.GREEN)
    box.judge(canvas, word, colour, session.verified)
    if session.wrong:
        canvas.write(
            Text.CHECK_WATER,
            (canvas.width / 2, below),
            CAPTION + 2,
            BOLD,
            theme.YELLOW,
            Align.CENTRE,
            canvas.width - 40,
        )


def _ticks(canvas: Canvas, view: CalibrateView) -> None:
    """Draw a mark per step between the lower labels: filled if done, ringed if current."""
    pitch, size = 52.0, 26.0
    left, y = canvas.width / 2 - pitch * (len(STEPS) - 1) / 2, canvas.height - _TICKS_PX
    for number, step in enumerate(STEPS):
        x = left + pitch * number
        is_done, is_current = view.session.done(step), step is view.step
        if is_current:
            canvas.box(x - size, y - size / 2 - 6, 2 * size, size + 12, theme.PANEL, 10, (theme.WHITE, 3))
        canvas.box(
            x - size / 2,
            y - size / 2,
            size,
            size,
            theme.GREEN if is_done else theme.LINE,
            size / 2 if not is_done else 5,
        )
        if is_done:
            canvas.write("✓", (x, y + 9), CAPTION, BLACK, theme.INK, Align.CENTRE)
