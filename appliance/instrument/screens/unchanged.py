"""Owns the painter that draws nothing twice: where a view would look as the one before, the picture that stands is
shown again.

A screen is presented at each beat, sixty times a second, and seldom is anything new on it: live images come ten times a
second, words at a key. Drawing all the same would keep a graphics card, and a battery, at work for nothing.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass

import moderngl
import numpy as np
from numpy.typing import NDArray

from appliance.instrument.machine.words import Language
from appliance.instrument.screens import theme
from appliance.instrument.screens.painter import Painter
from appliance.instrument.screens.views import AnyView

MOVES_HZ = 20.0
"""Pictures per second of what moves by itself: fringes that drift, a bar that swings, a cloud that nods in ten seconds.
"""


class FrugalPainter(Painter):
    """Paints as a ``Painter``, and only what changed. Arrays of a view must not change while it is shown."""

    def __init__(
        self, context: moderngl.Context, size_px: tuple[int, int], language: Language = Language.ENGLISH
    ) -> None:
        super().__init__(context, size_px, language)
        self._drawn: tuple[tuple[AnyView, Language, tuple[bool, int]], NDArray[np.uint8]] | None = None
        """View, language and moment that the picture which stands was drawn for, and the picture; ``None``: it has to
        be drawn."""

    def draw(self, view: AnyView, time_s: float) -> NDArray[np.uint8]:
        """Return the picture of ``view`` as ``Painter.draw`` does; it may be as old as 1 / ``MOVES_HZ``.

        Raises DeviceGone.
        """
        asked = (view, self.language, moment(view, time_s))
        if self._drawn is not None and same(self._drawn[0], asked):
            return self._drawn[1]
        self._drawn = None
        picture = super().draw(view, time_s)
        self._drawn = asked, picture
        return picture

    def preview(self) -> NDArray[np.uint8] | None:
        """Return the cloud alone as ``Painter.preview`` does; the picture that stood is drawn over."""
        self._drawn = None
        return super().preview()


def moment(view: AnyView, time_s: float) -> tuple[bool, int]:
    """Return what ``time_s`` means to the picture of ``view``: times of equal moments need no drawing anew."""
    return theme.flash_on(time_s), math.floor(time_s * MOVES_HZ) if view.moves else 0


def same(a: object, b: object) -> bool:
    """Return True if two views show the same: equal values, and the very same arrays, which must not change while
    shown."""
    if a is b:
        return True
    if type(a) is not type(b) or isinstance(a, np.ndarray):
        return False
    if isinstance(a, tuple) and isinstance(b, tuple):
        return len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        return same(tuple(a.items()), tuple(b.items()))
    if is_dataclass(a) and not isinstance(a, type):
        return all(same(getattr(a, one.name), getattr(b, one.name)) for one in fields(a))
    return bool(a == b)
