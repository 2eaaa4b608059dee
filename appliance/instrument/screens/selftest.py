"""Screens of the start: each device and part with its result, as soon as it is known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from appliance.instrument.machine.alerts import Alert
from appliance.instrument.machine.words import Label, Text
from appliance.instrument.screens import theme
from appliance.instrument.screens.canvas import Align, Canvas
from appliance.instrument.screens.frame import alert_text, alerts_top
from appliance.instrument.screens.theme import BLACK, BODY, BOLD, CAPTION, HEADLINE, REGULAR
from appliance.instrument.screens.views import DeviceLine, SelfTestView

DEVICE_NAMES: Mapping[str, Text] = {
    "camera.left": Text.CAMERA_LEFT,
    "camera.right": Text.CAMERA_RIGHT,
    "board": Text.BOARD,
    "keys": Text.KEYS,
    "projector": Text.PROJECTOR,
    "display": Text.DISPLAY,
    "storage": Text.STORAGE,
    "calibration": Text.CALIBRATION,
    "worker": Text.WORKER,
}
"""Names of the devices of the rig file; a device not listed is shown by its own name."""
_BANNER_PX, _FRINGE_SPEED = 104.0, 1.6
_ROWS = 5
_LEAST_DETAIL_PX, _DETAIL_PX = 52.0, 26.0
_RESULTS = {
    True: (Text.OK, theme.WHITE, theme.GREEN, theme.WHITE),
    False: (Text.FAILED, theme.YELLOW, theme.YELLOW, theme.YELLOW),
    None: (Text.WAITING, theme.MUTED, theme.LINE, theme.MUTED),
}
"""Text of the result, and colours of name, mark and text."""


def draw_self_test(canvas: Canvas, view: SelfTestView, time_s: float) -> None:
    word, colour = Text.SELF_TEST if view.opened else Text.STARTING, theme.WHITE
    if view.finished:
        word, colour = (Text.ALL_READY, theme.GREEN) if view.passed else (Text.SEE_BELOW, theme.YELLOW)
    _banner(canvas, word, colour, view.version, time_s)
    _devices(canvas, view.devices, alerts_top(canvas, view.alerts))


def _banner(canvas: Canvas, word: Text, colour: theme.Colour, version: str, time_s: float) -> None:
    """Draw the banner up to the upper edge: the only key label there is GO ON, on the right."""
    canvas.water(0, 0, canvas.width, _BANNER_PX, _FRINGE_SPEED * time_s, 0.5)
    canvas.box(0, 0, 450, _BANNER_PX, theme.INK, (0, 0, 40, 0))
    canvas.write("KINGFISHER", (24, 52), HEADLINE - 8, BLACK)
    name_px = canvas.measure("KINGFISHER", HEADLINE - 8, BLACK)
    canvas.write(version, (24 + name_px + 14, 52), CAPTION, REGULAR, theme.MUTED, max_width=412 - name_px)
    canvas.write(word, (24, 91), BODY + 2, BLACK, colour, max_width=410)


def _devices(canvas: Canvas, devices: Sequence[DeviceLine], bottom: float) -> None:
    """Draw the devices in two columns; the remedy of a failed one stands below its name.

    If there is little space, only such lines are higher.
    """
    top = _BANNER_PX + (10 if bottom > 380 else 4)
    column_px = canvas.width / 2
    for column in range(2):
        lines = devices[_ROWS * column : _ROWS * (column + 1)]
        pitch = min(64.0, (bottom - top) / _ROWS)
        heights = [pitch] * len(lines)
        if pitch < _LEAST_DETAIL_PX:
            # Rows of equal height have no space for remedies, so only those of failed devices get it.
            reasons = [bool(line.detail) and line.works is False for line in lines]
            pitch = (bottom - top - _DETAIL_PX * sum(reasons)) / _ROWS
            if pitch >= _LEAST_DETAIL_PX - _DETAIL_PX:
                heights = [pitch + _DETAIL_PX * reason for reason in reasons]
        y = top
        for line, height in zip(lines, heights, strict=True):
            _line(canvas, line, column_px * column + 18, column_px * (column + 1) - 18, y, height)
            y += height


def _line(canvas: Canvas, line: DeviceLine, left: float, right: float, top: float, pitch: float) -> None:
    word, ink, mark, result_ink = _RESULTS[line.works]
    name = DEVICE_NAMES.get(line.device, line.device)
    detail = _remedy(canvas, line.detail) if pitch >= _LEAST_DETAIL_PX else ""
    tight = pitch < 60
    baseline = top + (0.5 * pitch + (7 if tight else 10) if not detail else 20 if tight else 26)
    # A square instead of a dot marks a failure without colour.
    canvas.box(left, baseline - 20, 20, 20, mark, 3 if line.works is False else 10)
    word_px = canvas.write(word, (right, baseline), BODY, BLACK, result_ink, Align.RIGHT)
    canvas.write(
        name,
        (left + 32, baseline),
        CAPTION + 2 if tight else BODY - 2,
        BOLD,
        ink,
        max_width=right - word_px - left - 44,
    )
    canvas.write(
        detail,
        (left + 32, baseline + (27 if tight else 28)),
        CAPTION,
        REGULAR,
        theme.MUTED,
        max_width=right - left - 32,
    )


def _remedy(canvas: Canvas, detail: Alert | Label) -> Label:
    """Return the remedy of an alert; the device's own message is for the log."""
    return alert_text(detail, canvas.language)[1] if isinstance(detail, Alert) else detail
