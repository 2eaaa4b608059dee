"""Drawing of views as pictures; an unchanged view is not drawn again.

A screen is presented at each cycle, sixty times a second, but seldom changes: live images come ten times a second, text
changes at a key. Drawing all the same would keep a graphics card, and a battery, busy for nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass, replace
from functools import partial
from types import TracebackType
from typing import Any, Self

import moderngl
import numpy as np
from numpy.typing import NDArray

from appliance.instrument.machine.words import Language, Text
from appliance.instrument.screens import theme
from appliance.instrument.screens.aim import draw_aim
from appliance.instrument.screens.calibrate import draw_calibrate
from appliance.instrument.screens.canvas import Canvas
from appliance.instrument.screens.cloud import CloudPainter
from appliance.instrument.screens.frame import draw_alerts, draw_key_labels
from appliance.instrument.screens.menu import draw_menu
from appliance.instrument.screens.progress import draw_cooling, draw_progress, draw_safe, draw_saving, draw_shutdown
from appliance.instrument.screens.review import CLOUD_PX, draw_gallery, draw_review
from appliance.instrument.screens.selftest import draw_self_test
from appliance.instrument.screens.theme import BAR_PX
from appliance.instrument.screens.views import (
    AimView,
    AnyView,
    CalibrateView,
    CoolingView,
    GalleryView,
    MenuView,
    ProgressView,
    ReviewView,
    SafeView,
    SavingView,
    SelfTestView,
    ShutdownView,
)
from appliance.measure import FaultCode
from drivers.api import Key

MOVES_HZ = 20.0
"""Pictures per second of animations: drifting fringes, a swinging bar, a cloud that nods in ten seconds."""
_DRAWINGS: Mapping[type[AnyView], Callable[[Canvas, Any, float], None]] = {
    SelfTestView: draw_self_test,
    AimView: draw_aim,
    ProgressView: draw_progress,
    SavingView: draw_saving,
    MenuView: draw_menu,
    GalleryView: draw_gallery,
    CalibrateView: draw_calibrate,
    CoolingView: draw_cooling,
    SafeView: draw_safe,
    ShutdownView: draw_shutdown,
}
"""Function that draws each view; that of ``ReviewView`` needs the painter's cloud."""
_STILL = (AimView, MenuView, GalleryView, CoolingView)
"""Views without animation except for a flashing alert."""


class Painter:
    """Draws views as pictures of ``size_px`` (width, height), and only if they have changed.

    A context manager: its GL objects end with it. The context may be shared with others; it is made current for each
    drawing, in the calling thread.
    """

    def __init__(
        self, context: moderngl.Context, size_px: tuple[int, int], language: Language = Language.ENGLISH
    ) -> None:
        self._context = context
        self.language = language
        """May be changed between two drawings."""
        self._drawn: tuple[tuple[AnyView, Language, tuple[bool, int]], NDArray[np.uint8]] | None = None
        """View, language and moment of the present picture, and the picture; ``None``: it has to be drawn."""
        with context:
            self._canvas = Canvas(context, size_px)
            # As high as the screen, so that a turning cloud is not cut off; labels are drawn over it.
            self._cloud = CloudPainter(context, self._canvas.pixels(0, 0, CLOUD_PX, self._canvas.height)[2:])
        self._drawings: Mapping[type[AnyView], Callable[[Canvas, Any, float], None]] = {
            **_DRAWINGS,
            ReviewView: partial(draw_review, self._cloud),
        }

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._context:
            self._cloud.close()
            self._canvas.close()

    def preview(self) -> NDArray[np.uint8] | None:
        """Return the cloud of the latest ``ReviewView`` as the camera saw it, (h, w, 3) uint8 RGB.

        ``None`` without points. It overwrites the picture that ``draw`` returned.
        """
        self._drawn = None
        if self._cloud.empty:
            return None
        with self._context:
            self._canvas.begin(theme.INK)
            # At time 0 the cloud is seen from the camera, so that a scan's stored picture does not depend on the time.
            left, top, width, height = self._canvas.pixels(0, BAR_PX, CLOUD_PX, self._canvas.height - 2 * BAR_PX)
            self._cloud.draw(self._canvas.framebuffer, (left, top, width, height), 0.0)
            return self._canvas.finish()[top : top + height, left : left + width].copy()

    @property
    def canvas(self) -> Canvas:
        """Canvas of the latest view, with a record of its text and images."""
        return self._canvas

    def draw(self, view: AnyView, time_s: float) -> NDArray[np.uint8]:
        """Return the picture of ``view`` at ``time_s``; it may be as old as 1 / ``MOVES_HZ``.

        ``time_s``: any steady clock, for animations. The picture is (height, width, 3) uint8 RGB, row 0 at the top, in
        the same memory each time. Arrays of a view must not change while it is shown. Raises DeviceGone when the GL
        context failed.
        """
        request = (view, self.language, animation_moment(view, time_s))
        if self._drawn is not None and is_same(self._drawn[0], request):
            return self._drawn[1]
        self._drawn = None
        picture = self._paint(without_shown_alerts(view), time_s)
        self._drawn = request, picture
        return picture

    def _paint(self, view: AnyView, time_s: float) -> NDArray[np.uint8]:
        with self._context:
            canvas = self._canvas
            canvas.language = self.language
            canvas.begin(theme.INK)
            self._drawings[type(view)](canvas, view, time_s)
            # Drawn last, so that no screen can cover a warning or the label of a key.
            draw_alerts(canvas, view.alerts, time_s)
            dim = isinstance(view, AimView | CalibrateView) and not view.scan_allowed
            urgent = frozenset(key for key, word in view.keys.items() if word in (Text.SEEN, Text.ANYWAY))
            draw_key_labels(canvas, view.keys, frozenset({Key.SCAN}) if dim else frozenset(), urgent)
            return canvas.finish()


def without_shown_alerts(view: AnyView) -> AnyView:
    """Return the view without the alerts that its screen shows by itself."""
    match view:
        case SafeView():
            shown_codes = {view.alert.code}
        case ShutdownView():
            shown_codes = set() if view.reason is None else {view.reason.code}
        case CoolingView():
            shown_codes = {FaultCode.HOT}
        case _:
            return view
    return replace(view, alerts=tuple(alert for alert in view.alerts if alert.code not in shown_codes))


def animation_moment(view: AnyView, time_s: float) -> tuple[bool, int]:
    """Return the moment of an animation: pictures of ``view`` with the same moment are equal."""
    still = isinstance(view, _STILL) or (isinstance(view, ProgressView) and not view.computes)
    return theme.flash_on(time_s), 0 if still else math.floor(time_s * MOVES_HZ)


def is_same(a: object, b: object) -> bool:
    """Return True if two views look the same: equal values, and identical arrays.

    Arrays must not change while shown.
    """
    if a is b:
        return True
    if type(a) is not type(b) or isinstance(a, np.ndarray):
        return False
    if isinstance(a, tuple) and isinstance(b, tuple):
        return len(a) == len(b) and all(map(is_same, a, b))
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        return is_same(tuple(a.items()), tuple(b.items()))
    if is_dataclass(a) and not isinstance(a, type):
        return all(is_same(getattr(a, item.name), getattr(b, item.name)) for item in fields(a))
    return bool(a == b)
