"""Owns the screens that wait: start-up, recording, computing, saving, switching off, and a fault that fills all."""

from __future__ import annotations

from collections.abc import Sequence

from appliance.screens import theme
from appliance.screens.canvas import Align, Canvas
from appliance.screens.frame import alert_colours, words_of
from appliance.screens.texts import DEVICE_NAMES, Language, Text
from appliance.screens.theme import BLACK, BODY, BOLD, CAPTION, HEADLINE, HUGE, REGULAR, TITLE
from appliance.screens.views import (
    ArmedView,
    BootView,
    CaptureView,
    CheckView,
    DeviceLine,
    DeviceResult,
    FaultView,
    ReconstructView,
    SavingView,
    SelfTestView,
    ShutdownView,
)

_LINE_PX = 34.0
_FRINGE_SPEED = 1.6


def draw_boot(canvas: Canvas, view: BootView, language: Language, time_s: float) -> None:
    canvas.water(0, 0, canvas.width, 132, _FRINGE_SPEED * time_s, 0.63)
    canvas.words("KINGFISHER", 40, 86, HEADLINE, BLACK)
    _title(canvas, Text.STARTING, view.version, language)
    _devices(canvas, view.devices, language)


def draw_self_test(canvas: Canvas, view: SelfTestView, language: Language, time_s: float) -> None:
    canvas.water(0, 0, canvas.width, 132, _FRINGE_SPEED * time_s, 0.63)
    canvas.words("KINGFISHER", 40, 86, HEADLINE, BLACK)
    word = Text.SELF_TEST if not view.finished else Text.ALL_READY if view.passed else Text.SEE_BELOW
    _title(canvas, word, view.version, language)
    _devices(canvas, view.devices, language)


def _title(canvas: Canvas, word: Text, version: str, language: Language) -> None:
    canvas.words(word.in_language(language), canvas.width - 40, 66, BODY, BOLD, align=Align.RIGHT)
    canvas.words(version, canvas.width - 40, 100, CAPTION, REGULAR, align=Align.RIGHT)


def _devices(canvas: Canvas, devices: Sequence[DeviceLine], language: Language) -> None:
    for number, line in enumerate(devices):
        baseline = 168 + number * _LINE_PX
        name = DEVICE_NAMES[line.device].in_language(language) if line.device in DEVICE_NAMES else line.device
        match line.result:
            case DeviceResult.WORKS:
                dot, word, colour = theme.GREEN, Text.OK, theme.WHITE
            case DeviceResult.FAILED:
                dot, word, colour = theme.YELLOW, Text.FAILED, theme.YELLOW
            case DeviceResult.WAITING:
                dot, word, colour = theme.LINE, Text.WAITING, theme.MUTED
        if line.result is DeviceResult.FAILED:  # a square, not a dot: the shape says it without colour
            canvas.box(42, baseline - 20, 20, 20, dot, 3)
        else:
            canvas.box(42, baseline - 20, 20, 20, dot, 10)
        canvas.words(
            name, 80, baseline, BODY, BOLD, theme.MUTED if word is Text.WAITING else theme.WHITE, max_width=246
        )
        canvas.words(line.detail, 334, baseline, CAPTION, REGULAR, theme.MUTED, max_width=292)
        canvas.words(word.in_language(language), canvas.width - 40, baseline, BODY, BLACK, colour, Align.RIGHT)


def draw_armed(canvas: Canvas, view: ArmedView, language: Language) -> None:
    middle = canvas.width / 2
    canvas.words(Text.GET_READY.in_language(language), middle, 218, HUGE, BLACK, align=Align.CENTRE, max_width=740)
    canvas.words(Text.LASERS_OFF.in_language(language), middle, 290, BODY, BOLD, theme.MUTED, Align.CENTRE, 740)


def draw_check(canvas: Canvas, view: CheckView, language: Language, time_s: float) -> None:
    middle = canvas.width / 2
    canvas.words(Text.CHECKING.in_language(language), middle, 218, HUGE, BLACK, align=Align.CENTRE, max_width=740)
    canvas.words(Text.MAY_MOVE.in_language(language), middle, 290, BODY, BOLD, theme.MUTED, Align.CENTRE, 740)
    _progress(canvas, view.progress, time_s)


def draw_capture(canvas: Canvas, view: CaptureView, language: Language) -> None:
    middle = canvas.width / 2
    canvas.words(
        Text.HOLD_STILL.in_language(language), middle, 218, HUGE, BLACK, align=Align.CENTRE, max_width=canvas.width - 60
    )
    left, gap = 60.0, 4.0
    step = (canvas.width - 2 * left + gap) / max(1, view.frames)
    for frame in range(view.frames):
        done = frame < view.frames_done
        canvas.box(left + frame * step, 262, step - gap, 40, theme.AQUA if done else theme.PANEL, 5)
    canvas.words(f"{view.frames_done}/{view.frames}", middle, 366, TITLE, BOLD, align=Align.CENTRE)


def draw_reconstruct(canvas: Canvas, view: ReconstructView, language: Language, time_s: float) -> None:
    canvas.water(0, 0, canvas.width, 170, 4.0 * _FRINGE_SPEED * time_s)
    middle = canvas.width / 2
    canvas.words(Text.COMPUTING.in_language(language), middle, 268, HUGE - 12, BLACK, align=Align.CENTRE, max_width=700)
    _progress(canvas, view.progress, time_s)


def _progress(canvas: Canvas, progress: float | None, time_s: float) -> None:
    middle = canvas.width / 2
    canvas.box(60, 310, canvas.width - 120, 34, theme.PANEL, 17)
    if progress is not None:
        part = min(1.0, max(0.0, progress))
        canvas.box(60, 310, max(34.0, (canvas.width - 120) * part), 34, theme.AQUA, 17)
        canvas.words(f"{100 * part:.0f} %", middle, 398, TITLE, BOLD, align=Align.CENTRE)
    else:  # nobody knows how long: something that moves, without pretending to a length
        at = 60 + (canvas.width - 280) * (0.5 - 0.5 * abs(2.0 * (0.4 * time_s % 1.0) - 1.0)) * 2.0
        canvas.box(at, 310, 160, 34, theme.AQUA, 17)


def draw_saving(canvas: Canvas, view: SavingView, language: Language, time_s: float) -> None:
    middle = canvas.width / 2
    if view.saved:
        canvas.box(middle - 330, 110, 660, 220, theme.DEEP, 36, theme.GREEN, 8)
        canvas.words(Text.SAVED.in_language(language), middle, 212, HUGE, BLACK, align=Align.CENTRE, max_width=600)
        canvas.words(view.scan_id, middle, 268, TITLE, BOLD, align=Align.CENTRE)
        canvas.words(Text.SAFE_ON_DISK.in_language(language), middle, 312, BODY, REGULAR, theme.MUTED, Align.CENTRE)
        return
    canvas.words(Text.SAVING.in_language(language), middle, 212, HUGE, BLACK, align=Align.CENTRE, max_width=700)
    canvas.words(view.scan_id, middle, 268, TITLE, BOLD, theme.MUTED, Align.CENTRE)
    at = 60 + (canvas.width - 280) * (1.0 - abs(2.0 * (0.4 * time_s % 1.0) - 1.0))
    canvas.box(60, 310, canvas.width - 120, 24, theme.PANEL, 12)
    canvas.box(at, 310, 160, 24, theme.AQUA, 12)


def draw_fault(canvas: Canvas, view: FaultView, language: Language, time_s: float) -> None:
    ground, ink, edge = alert_colours(view.alert.severity, time_s)
    canvas.box(0, 70, canvas.width, 330, ground, edge=edge, edge_width=10)
    canvas.box(40, 110, 120, 120, ink, 60)
    canvas.words("!", 100, 212, 110, BLACK, ground, Align.CENTRE)
    said, to_do = words_of(view.alert, language)
    canvas.words(said, 190, 200, HUGE, BLACK, ink, max_width=canvas.width - 230)
    canvas.words(to_do, 190, 262, TITLE, BOLD, ink, max_width=canvas.width - 230)
    canvas.paragraph(view.detail, 40, 318, CAPTION, ink, canvas.width - 80, 3)


def draw_shutdown(canvas: Canvas, view: ShutdownView, language: Language, time_s: float) -> None:
    middle = canvas.width / 2
    canvas.words(
        Text.POWERING_OFF.in_language(language), middle, 200, HUGE - 12, BLACK, align=Align.CENTRE, max_width=720
    )
    if view.saving:
        canvas.words(Text.SAVING.in_language(language), middle, 262, TITLE, BOLD, theme.YELLOW, Align.CENTRE)
        canvas.words(
            Text.WAIT_FOR_DARK.in_language(language), middle, 312, BODY, BOLD, align=Align.CENTRE, max_width=720
        )
    if view.reason is not None:
        ground, ink, edge = alert_colours(view.reason.severity, time_s)
        canvas.box(60, 350, canvas.width - 120, 90, ground, 24, edge, 7)
        said, _ = words_of(view.reason, language)
        canvas.words(said, middle, 412, HEADLINE - 4, BLACK, ink, Align.CENTRE, canvas.width - 180)
