"""Owns the way from a view to a picture."""

from __future__ import annotations

from dataclasses import replace
from types import TracebackType
from typing import Self, assert_never

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
from appliance.instrument.screens.gallery import draw_gallery
from appliance.instrument.screens.menu import draw_menu
from appliance.instrument.screens.progress import (
    draw_armed,
    draw_capture,
    draw_check,
    draw_reconstruct,
    draw_saving,
    draw_shutdown,
)
from appliance.instrument.screens.review import CLOUD_PX, draw_review
from appliance.instrument.screens.selftest import draw_boot, draw_self_test
from appliance.instrument.screens.stops import draw_cooling, draw_safe
from appliance.instrument.screens.theme import BAR_PX
from appliance.instrument.screens.views import (
    AimView,
    AnyView,
    ArmedView,
    BootView,
    CalibrateView,
    CaptureView,
    CheckView,
    CoolingView,
    GalleryView,
    KeyLabels,
    MenuView,
    ReconstructView,
    ReviewView,
    SafeView,
    SavingView,
    SelfTestView,
    ShutdownView,
)
from appliance.measure import FaultCode
from drivers.api import Key

_NONE: frozenset[Key] = frozenset()


class Painter:
    """Draws views at ``size_px`` (width, height) with a GL context that is current in the calling thread.

    A context manager: its GL objects end with it. The context may be shared with others; it is made current for
    each drawing.
    """

    def __init__(
        self, context: moderngl.Context, size_px: tuple[int, int], language: Language = Language.ENGLISH
    ) -> None:
        self._context = context
        self.language = language
        """May be changed between two drawings."""
        with context:
            self._canvas = Canvas(context, size_px)
            # As high as the screen: a cloud that turns out of its room is not cut off at a line, and labels are
            # drawn over it.
            self._cloud = CloudPainter(context, self._canvas.pixels(0, 0, CLOUD_PX, self._canvas.height)[2:])

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._context:
            self._cloud.close()
            self._canvas.close()

    def preview(self) -> NDArray[np.uint8] | None:
        """Return the cloud of the latest ``ReviewView`` alone, as the camera saw it: (h, w, 3) uint8 RGB; None
        without points.

        The picture that ``draw`` returned is drawn over.
        """
        if self._cloud.empty:
            return None
        with self._context:
            self._canvas.begin(theme.INK)
            # At time 0 the cloud stands as the camera saw it, so that a scan's stored picture does not depend on
            # when it was made.
            left, top, width, height = self._canvas.pixels(0, BAR_PX, CLOUD_PX, self._canvas.height - 2 * BAR_PX)
            self._cloud.draw(self._canvas.framebuffer, (left, top, width, height), 0.0)
            return self._canvas.finish()[top : top + height, left : left + width].copy()

    @property
    def canvas(self) -> Canvas:
        """Canvas on which the latest view was drawn; it knows what is written where."""
        return self._canvas

    def draw(self, view: AnyView, time_s: float) -> NDArray[np.uint8]:
        """Return the picture of ``view`` at ``time_s`` (any steady clock: it moves what flashes or turns).

        (height, width, 3) uint8 RGB, row 0 at the top, in the same memory each time. Raises DeviceGone when the GL
        context failed.
        """
        view = said_once(view)
        with self._context:
            canvas, language = self._canvas, self.language
            canvas.begin(theme.INK)
            dim = urgent = _NONE
            match view:
                case BootView():
                    draw_boot(canvas, view, language, time_s)
                case SelfTestView():
                    draw_self_test(canvas, view, language, time_s)
                case AimView():
                    draw_aim(canvas, view, language)
                    urgent = frozenset({Key.SCAN}) if view.keys.get(Key.SCAN) is Text.ANYWAY else _NONE
                    dim = _NONE if view.scan_allowed else frozenset({Key.SCAN})
                case ArmedView():
                    draw_armed(canvas, view, language)
                case CaptureView():
                    draw_capture(canvas, view, language)
                case CheckView():
                    draw_check(canvas, view, language, time_s)
                case ReconstructView():
                    draw_reconstruct(canvas, view, language, time_s)
                case ReviewView():
                    draw_review(canvas, self._cloud, view, language, time_s)
                case SavingView():
                    draw_saving(canvas, view, language, time_s)
                case MenuView():
                    draw_menu(canvas, view, language)
                case GalleryView():
                    draw_gallery(canvas, view, language)
                case CalibrateView():
                    draw_calibrate(canvas, view, language, time_s)
                    dim = _NONE if view.scan_allowed else frozenset({Key.SCAN})
                case CoolingView():
                    draw_cooling(canvas, view, language)
                case SafeView():
                    draw_safe(canvas, view, language, time_s)
                case ShutdownView():
                    draw_shutdown(canvas, view, language, time_s)
                case _:
                    assert_never(view)
            # Last, over everything: no screen can cover a warning or the meaning of a key.
            draw_alerts(canvas, view.alerts, language, time_s)
            draw_key_labels(canvas, view.keys, language, dim, urgent | acknowledges(view.keys))
            return canvas.finish()


def acknowledges(keys: KeyLabels) -> frozenset[Key]:
    """Return the key that takes the warning above it for known: in the colour of the warning."""
    return frozenset(key for key, word in keys.items() if word is Text.SEEN)


def said_once(view: AnyView) -> AnyView:
    """Return the view without the alerts that its screen is made of: nothing is said twice."""
    match view:
        case SafeView():
            said = {view.alert.code}
        case ShutdownView():
            said = set() if view.reason is None else {view.reason.code}
        case CoolingView():
            said = {FaultCode.HOT}
        case _:
            return view
    return replace(view, alerts=tuple(alert for alert in view.alerts if alert.code not in said))
