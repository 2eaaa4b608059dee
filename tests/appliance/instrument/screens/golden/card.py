"""Owns the dive card: one printed page with the keys, the way to a good scan, and what flashes in red."""

from __future__ import annotations

from pathlib import Path

import moderngl
import numpy as np
from numpy.typing import NDArray

from appliance.instrument.machine.alerts import Severity
from appliance.instrument.machine.words import Language, Text
from appliance.instrument.screens import theme
from appliance.instrument.screens.canvas import Align, Canvas
from appliance.instrument.screens.frame import alert_text
from appliance.instrument.screens.theme import BLACK, BODY, BOLD, CAPTION, HEADLINE, REGULAR, TITLE
from appliance.measure.light.volume import STANDARD
from tests.appliance.instrument.screens.golden.scenes import ALERTS

SIZE_PX = (1748, 2480)
"""A5 at 300 px per inch; 800 × 1135 units of the design."""
FOLDER = Path(__file__).parents[5] / "docs" / "operator"
_EDGE = 48.0
_DISPLAY_TOP_PX, _DISPLAY_PX = 102.0, (460.0, 276.0)
_LEGEND_TOP_PX, _LINE_PX = 382.0, 28.0
_STEPS_TOP_PX, _STEP_PX = 448.0, 40.0


def path(language: Language) -> Path:
    return FOLDER / f"dive-card.{language.value}.png"


def steps(language: Language) -> tuple[str, ...]:
    """The way to a scan, with the words that stand on the display."""

    def say(text: Text) -> str:
        return text.in_language(language)

    near, far = f"{STANDARD.nearest_mm:.0f}", f"{STANDARD.farthest_mm:.0f}"
    if language is Language.GERMAN:
        return (
            f"Einschalten, warten auf {say(Text.ALL_READY)}.",
            f"{say(Text.MENU)}: {say(Text.WATER)} und {say(Text.EXPOSURE)} einstellen.",
            f"{near} bis {far} mm: {say(Text.CLOSER)} oder {say(Text.BACK)}, bis {say(Text.OK)}.",
            f"{say(Text.SCAN)} drücken. {say(Text.HOLD_STILL)}, bis das Licht aus ist.",
            f"{say(Text.GOOD)}, {say(Text.USABLE)}: {say(Text.KEEP)}. {say(Text.BAD)}: {say(Text.REPEAT)}.",
            f"{say(Text.SAVED)} heißt: sicher auf dem Speicher.",
            f"BACK lang drücken, {say(Text.SWITCH_OFF)}: schaltet aus.",
        )
    return (
        f"Power on, wait for {say(Text.ALL_READY)}.",
        f"{say(Text.MENU)}: set {say(Text.WATER)} and {say(Text.EXPOSURE)}.",
        f"{near} to {far} mm: {say(Text.CLOSER)} or {say(Text.BACK)} until {say(Text.OK)}.",
        f"Press {say(Text.SCAN)}. {say(Text.HOLD_STILL)} until the light is off.",
        f"{say(Text.GOOD)}, {say(Text.USABLE)}: {say(Text.KEEP)}. {say(Text.BAD)}: {say(Text.REPEAT)}.",
        f"{say(Text.SAVED)} means: safe on the disk.",
        f"Hold BACK, {say(Text.SWITCH_OFF)}: switches off.",
    )


def legend(language: Language) -> tuple[str, ...]:
    """What the small things on the aim screen above mean, with the words and numbers that it shows."""
    if language is Language.GERMAN:
        return (
            "L, R: linke, rechte Kamera · 12 ms: Belichtung",
            f"{Text.SALT.german}: eingestellt · 34 °C: Gehäuse · 4°: Schräge",
        )
    return (
        "L, R: left, right camera · 12 ms: exposure",
        f"{Text.SALT.english}: water set · 34 °C: housing · 4°: slant",
    )


def draw_card(context: moderngl.Context, aim: NDArray[np.uint8], language: Language) -> NDArray[np.uint8]:
    """(h, w, 3) uint8 RGB; ``aim`` is the picture of the aim screen."""
    with context:
        canvas = Canvas(context, SIZE_PX)
        try:
            canvas.begin(theme.hex_colour(0xFFFFFF))
            _head(canvas, language)
            _keys(canvas, aim)
            _legend(canvas, language)
            _steps(canvas, language)
            _alarms(canvas, language)
            return canvas.finish().copy()
        finally:
            canvas.close()


def _head(canvas: Canvas, language: Language) -> None:
    canvas.box(0, 0, canvas.width, 84, theme.INK)
    canvas.write("KINGFISHER", (_EDGE, 60), HEADLINE, BLACK)
    title = "TAUCHKARTE" if language is Language.GERMAN else "DIVE CARD"
    canvas.write(title, (canvas.width - _EDGE, 58), TITLE, BOLD, align=Align.RIGHT)


def _keys(canvas: Canvas, aim: NDArray[np.uint8]) -> None:
    """The display as the diver holds it, and the keys beside it."""
    left, top = (canvas.width - _DISPLAY_PX[0]) / 2, _DISPLAY_TOP_PX
    width, height = _DISPLAY_PX
    canvas.image("aim", aim, left, top, width, height)
    right = canvas.width - left + 16
    for name, x, y in (
        ("UP", left - 126, top), ("DOWN", left - 126, top + height - 50),
        ("SCAN", right, top), ("BACK", right, top + height - 50),
    ):  # fmt: skip
        canvas.box(x, y, 110, 50, theme.INK, 25)
        canvas.write(name, (x + 55, y + 35), CAPTION + 2, BLACK, theme.WHITE, Align.CENTRE)


def _legend(canvas: Canvas, language: Language) -> None:
    for number, line in enumerate(legend(language)):
        y = _LEGEND_TOP_PX + _LINE_PX * (number + 0.8)
        canvas.write(line, (canvas.width / 2, y), CAPTION, REGULAR, theme.INK, Align.CENTRE, canvas.width - 60)


def _steps(canvas: Canvas, language: Language) -> None:
    for number, step in enumerate(steps(language)):
        y = _STEPS_TOP_PX + _STEP_PX * number
        canvas.box(_EDGE - 18, y, 36, 36, theme.INK, 18)
        canvas.write(str(number + 1), (_EDGE, y + 28), CAPTION + 2, BLACK, theme.WHITE, Align.CENTRE)
        canvas.write(step, (_EDGE + 34, y + 28), CAPTION + 2, BOLD, theme.INK, max_width=canvas.width - _EDGE - 56)


def _alarms(canvas: Canvas, language: Language) -> None:
    """Every critical alert, and how to tell a warning."""
    top = _STEPS_TOP_PX + _STEP_PX * len(steps(language)) + 8
    critical = [alert for alert in ALERTS.values() if alert.severity is Severity.CRITICAL]
    pitch = (canvas.height - 92 - top) / len(critical)
    for number, alert in enumerate(critical):
        headline, action = alert_text(alert, language)
        y = top + pitch * number
        canvas.box(30, y, canvas.width - 60, pitch - 6, theme.BLOOD, 8)
        canvas.write(headline, (_EDGE, y + 0.42 * pitch), BODY - 2, BLACK, theme.WHITE)
        canvas.write(action, (_EDGE, y + 0.81 * pitch), CAPTION, BOLD, theme.WHITE)
    y = canvas.height - 84
    canvas.box(30, y, canvas.width - 60, 44, theme.YELLOW, 8)
    german = language is Language.GERMAN
    yellow = "GELB: Warnung, und was zu tun ist" if german else "YELLOW: a warning, and what to do"
    said = f"{yellow}. BACK: {Text.SEEN.in_language(language)}."
    canvas.write(said, (_EDGE, y + 31), CAPTION + 2, BOLD, theme.INK, max_width=canvas.width - 2 * _EDGE)
    last = "Kein Scan wird unter Wasser gelöscht." if german else "No scan is ever deleted under water."
    canvas.write(last, (canvas.width / 2, canvas.height - 14), CAPTION, REGULAR, theme.INK, Align.CENTRE)
