"""Owns what surrounds the content of every screen: key labels at the edge, and the alert above all else."""

from __future__ import annotations

from collections.abc import Sequence

from appliance.machine.alerts import Alert, Severity
from appliance.screens import theme
from appliance.screens.canvas import Align, Canvas
from appliance.screens.texts import Language, worded
from appliance.screens.theme import BAR_PX, BLACK, BOLD, KEY_CORNERS
from appliance.screens.views import KeyLabels
from drivers.api import Key

_PAD_PX = 24
_RADIUS_PX = 20
_LABEL_PX = 54
ALERT_PX, CRITICAL_PX = 110, 146


def draw_key_labels(canvas: Canvas, keys: KeyLabels, language: Language, dim: frozenset[Key] = frozenset()) -> None:
    """Each label touches the edge of the display at its key; the main key's is bright. ``dim`` ones do nothing now."""
    for key, text in keys.items():
        right, bottom = KEY_CORNERS[key].value
        words = worded(text, language)
        room = theme.LABEL_MAX_PX - 2 * _PAD_PX
        width = min(room, canvas.measure(words, theme.BODY, BLACK)) + 2 * _PAD_PX
        width = max(theme.LABEL_MIN_PX, width)
        left = canvas.width - width if right else 0.0
        top = canvas.height - _LABEL_PX if bottom else 0.0
        main = key is Key.SCAN and key not in dim
        fill, ink = (theme.WHITE, theme.INK) if main else (theme.PANEL, theme.WHITE)
        if key in dim:
            ink = theme.MUTED.faded(0.6)
        inner = [0.0, 0.0, 0.0, 0.0]  # only the corner that points into the picture is round
        inner[(0 if bottom else 3) if right else (1 if bottom else 2)] = _RADIUS_PX
        canvas.box(left, top, width, _LABEL_PX, fill, inner)
        # A stroke on the edge itself says: the key is here.
        canvas.box(canvas.width - 7 if right else 0.0, top, 7, _LABEL_PX, theme.AQUA if key not in dim else theme.LINE)
        middle = left + width / 2 + (-2 if right else 2)
        canvas.words(words, middle, top + 38, theme.BODY, BLACK, ink, Align.CENTRE, room)


def draw_alerts(canvas: Canvas, alerts: Sequence[Alert], language: Language, time_s: float) -> None:
    """The gravest alert as a band across the picture, above the lower bar; the others as a number."""
    if not alerts:
        return
    gravest = max(alerts, key=lambda alert: alert.severity)
    critical = gravest.severity is Severity.CRITICAL
    height = CRITICAL_PX if critical else ALERT_PX
    top = alerts_top(canvas, alerts)
    fill, ink, edge = alert_colours(gravest.severity, time_s)
    canvas.box(0, top, canvas.width, height, fill, edge=edge, edge_width=7)
    badge = height - 40
    canvas.box(26, top + 20, badge, badge, ink, badge / 2)
    canvas.words("!", 26 + badge / 2, top + 20 + badge * 0.86, round(badge), BLACK, fill, Align.CENTRE)
    left = 26 + badge + 26
    more = len(alerts) - 1
    room = canvas.width - left - (112 if more else 24)
    headline = theme.HUGE - 6 if critical else theme.HEADLINE
    said, to_do = words_of(gravest, language)
    canvas.words(said, left, top + (88 if critical else 58), headline, BLACK, ink, max_width=room)
    canvas.words(to_do, left, top + height - 18, theme.BODY + 2, BOLD, ink, max_width=room)
    if more:
        canvas.box(canvas.width - 96, top + height / 2 - 28, 72, 56, ink, 28)
        canvas.words(f"+{more}", canvas.width - 60, top + height / 2 + 11, theme.BODY + 2, BLACK, fill, Align.CENTRE)


def words_of(alert: Alert, language: Language) -> tuple[str, str]:
    """Headline and action."""
    if language is Language.GERMAN and alert.german is not None:
        return alert.german
    return alert.headline, alert.action


def alerts_top(canvas: Canvas, alerts: Sequence[Alert]) -> float:
    """Where the band of these alerts (at least one) begins."""
    critical = max(alert.severity for alert in alerts) is Severity.CRITICAL
    return canvas.height - BAR_PX - (CRITICAL_PX if critical else ALERT_PX)


def alert_colours(severity: Severity, time_s: float) -> tuple[theme.Colour, theme.Colour, theme.Colour]:
    """(ground, ink, edge) of an alert at a moment: white, solid yellow, or flashing red that stays readable."""
    match severity:
        case Severity.CRITICAL:
            return (theme.RED if theme.flash_on(time_s) else theme.INK), theme.WHITE, theme.RED
        case Severity.WARNING:
            return theme.YELLOW, theme.INK, theme.YELLOW
        case Severity.INFO:
            return theme.PANEL, theme.WHITE, theme.LINE
