"""Frame of every screen: title, key labels at the edge, and alerts."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import assert_never

from appliance.instrument.machine.alerts import Alert, Severity
from appliance.instrument.machine.leading import in_full
from appliance.instrument.machine.words import Label, Language, Text, worded
from appliance.instrument.screens import theme
from appliance.instrument.screens.canvas import Align, Canvas
from appliance.instrument.screens.theme import BAR_PX, BLACK, BODY, BOLD, CAPTION, HEADLINE, HUGE, KEY_CORNERS, TITLE
from appliance.instrument.screens.views import KeyLabels
from drivers.api import Key

LABEL_PX = 54
_PAD_PX = 22
_RADIUS_PX = 20
ALERT_PX, CRITICAL_PX, MARKS_PX = 95, 106, 34
"""Heights of the band of the alert in full, and of the row of marks above it with the names of the others."""


def draw_title(canvas: Canvas, title: Label, keys: KeyLabels, colour: theme.Colour = theme.WHITE) -> None:
    """Draw the name of the screen in the middle between the upper labels."""
    left, right = room_between(canvas, keys, bottom=False)
    size = TITLE
    width = canvas.measure(title, size, BLACK)
    middle = canvas.width / 2
    # In the middle of the screen if possible, so that titles of different screens are at the same place.
    if not left + width / 2 <= middle <= right - width / 2:
        middle = (left + right) / 2
    canvas.write(title, (middle, 42), size, BLACK, colour, Align.CENTRE, right - left)


def room_between(canvas: Canvas, keys: KeyLabels, bottom: bool) -> tuple[float, float]:
    """Return the left and right end of the space between the labels of a bar, with a margin."""
    left, right = 16.0, canvas.width - 16.0
    for key, text in keys.items():
        at_right, below = KEY_CORNERS[key]
        if below is not bottom:
            continue
        width = _label_width(canvas, canvas.translate(text)) + 16.0
        if at_right:
            right = canvas.width - width
        else:
            left = width
    return left, right


def draw_key_labels(
    canvas: Canvas,
    keys: KeyLabels,
    dim: frozenset[Key] = frozenset(),
    urgent: frozenset[Key] = frozenset(),
) -> None:
    """Draw each label at the edge of the display at its key; the main key's is bright.

    ``dim`` ones have no effect now and are hollow; ``urgent`` ones are yellow, for caution.
    """
    for key, label in keys.items():
        right, bottom = KEY_CORNERS[key]
        text = canvas.translate(label)
        width = _label_width(canvas, text)
        left = canvas.width - width if right else 0.0
        top = canvas.height - LABEL_PX if bottom else 0.0
        inner = [0.0, 0.0, 0.0, 0.0]  # only the corner that points into the picture is round
        inner[(0 if bottom else 3) if right else (1 if bottom else 2)] = _RADIUS_PX
        if key in dim:
            canvas.box(left, top, width, LABEL_PX, theme.INK, inner, (theme.LINE, 3))
            ink, mark = theme.MUTED, theme.LINE
        else:
            main = key is Key.SCAN or key in urgent
            fill = theme.YELLOW if key in urgent else theme.WHITE if main else theme.PANEL
            canvas.box(left, top, width, LABEL_PX, fill, inner)
            ink, mark = theme.INK if main else theme.WHITE, theme.AQUA
        # A stroke on the edge marks the key.
        canvas.box(canvas.width - 7 if right else 0.0, top, 7, LABEL_PX, mark)
        middle = left + width / 2 + (-3 if right else 3)
        lines = _label_lines(canvas, text)
        if text in _ARROWS:  # the font's own are small
            canvas.write(text, (middle, top + 44), HUGE - 20, BLACK, ink, Align.CENTRE)
            continue
        for baseline, line in zip((38,) if len(lines) == 1 else (24, 48), lines, strict=True):
            canvas.write(line, (middle, top + baseline), _LABEL_SIZES[len(lines)], BLACK, ink, Align.CENTRE)


_ARROWS = (Text.ARROW_UP.english, Text.ARROW_DOWN.english)
_BEFORE_NUMBER = re.compile(r" (?=\d)")
_LABEL_SIZES = {1: BODY, 2: CAPTION}


def _label_lines(canvas: Canvas, text: str) -> list[str]:
    """Return the label as one line, or as two if it is too long: EXPOSE, and below it 16 ms +12 dB."""
    # Split before a number, if any: HOLD: ADD, and below it 3.2 ms.
    numbered_part = _BEFORE_NUMBER.search(text)
    cut = text.find(" ") if numbered_part is None else numbered_part.start()
    first, space, second = text[:cut], cut > 0, text[cut + 1 :]
    one_line = not space or canvas.measure(text, BODY, BLACK) + 2 * _PAD_PX <= theme.LABEL_MAX_PX
    return [text] if one_line else [first, second]


def _label_width(canvas: Canvas, text: str) -> float:
    lines = _label_lines(canvas, text)
    width = max(canvas.measure(line, _LABEL_SIZES[len(lines)], BLACK) for line in lines) + 2 * _PAD_PX
    return max(theme.LABEL_MIN_PX, width)


def draw_alerts(canvas: Canvas, alerts: Sequence[Alert], time_s: float) -> None:
    """Draw the leading alert as a band above the lower bar, and the names of the others over it.

    Screens leave its space free: they draw above ``alerts_top``.
    """
    gravest = in_full(alerts)
    smaller_alerts = [alert for alert in alerts if alert is not gravest]
    if gravest is None:
        _marks(canvas, smaller_alerts, canvas.height - BAR_PX)
        return
    critical = gravest.severity is Severity.CRITICAL
    height = CRITICAL_PX if critical else ALERT_PX
    top = canvas.height - BAR_PX - height
    fill, ink, edge = alert_colours(gravest.severity, time_s)
    _marks(canvas, smaller_alerts, top)
    canvas.box(0, top, canvas.width, height, fill, edge=(edge, 7))
    badge = height - 32
    canvas.box(22, top + 16, badge, badge, ink, badge / 2)
    canvas.write("!", (22 + badge / 2, top + 16 + badge * 0.86), round(badge), BLACK, fill, Align.CENTRE)
    left = 22 + badge + 20
    room = canvas.width - left - 20
    headline, action = alert_text(gravest, canvas.language)
    canvas.write(
        headline,
        (left, top + (57 if critical else 47)),
        HEADLINE + 4 if critical else HEADLINE - 6,
        BLACK,
        ink,
        max_width=room,
    )
    canvas.write(action, (left, top + height - 12), BODY + 2, BOLD, ink, max_width=room)


def _marks(canvas: Canvas, smaller_alerts: Sequence[Alert], bottom: float) -> None:
    """Draw the headlines of the other alerts, the most severe first, and the number without space."""
    if not smaller_alerts:
        return
    # Passing alerts come first at any severity, since the diver can change their cause now. The others keep their order.
    ranked = sorted(smaller_alerts, key=lambda alert: (not alert.passing, -alert.severity))
    x, middle, count_px = 14.0, bottom - MARKS_PX / 2, 60.0
    for place, alert in enumerate(ranked):
        headline, action = alert_text(alert, canvas.language)
        headline = f"{headline}: {action}" if alert.passing else headline
        colour = theme.WHITE if alert.severity is Severity.INFO else theme.YELLOW
        more = len(ranked) - place
        # The last mark may go to the edge; others leave space for the count of those that do not fit.
        if x + 26 + canvas.measure(headline, CAPTION, BLACK) > canvas.width - (16 if more == 1 else count_px):
            canvas.write(f"+{more}", (x, bottom - 8), CAPTION, BLACK, colour)
            return
        canvas.box(x, middle - 8, 16, 16, theme.RED if alert.severity is Severity.CRITICAL else colour, 3)
        x += 26 + canvas.write(headline, (x + 26, bottom - 8), CAPTION, BLACK, colour) + 24


def alert_text(alert: Alert, language: Language) -> tuple[str, str]:
    """Return headline and action in ``language``."""
    if language is Language.GERMAN and alert.german is not None:
        return worded(alert.german[0], language), worded(alert.german[1], language)
    return alert.headline, alert.action


def alerts_top(canvas: Canvas, alerts: Sequence[Alert]) -> float:
    """Return the upper edge of the alerts, or of the lower bar if there are none.

    The area above is free.
    """
    bottom = canvas.height - BAR_PX
    gravest = in_full(alerts)
    if gravest is None:
        return bottom - (MARKS_PX if alerts else 0)
    band = CRITICAL_PX if gravest.severity is Severity.CRITICAL else ALERT_PX
    return bottom - band - (MARKS_PX if len(alerts) > 1 else 0)


def alert_colours(severity: Severity, time_s: float) -> tuple[theme.Colour, theme.Colour, theme.Colour]:
    """Return (ground, ink, edge) of an alert: white, solid yellow, or flashing red that stays readable."""
    match severity:
        case Severity.CRITICAL:
            return (theme.BLOOD if theme.flash_on(time_s) else theme.INK), theme.WHITE, theme.RED
        case Severity.WARNING:
            return theme.YELLOW, theme.INK, theme.YELLOW
        case Severity.INFO:
            return theme.PANEL, theme.WHITE, theme.LINE
        case unknown:
            assert_never(unknown)
