"""An alert has room of its own: whatever it is, no number, no row and no picture is lost under it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import moderngl
import pytest

from appliance.machine.alerts import Alert
from appliance.machine.words import Language, Text
from appliance.scan.fault import FaultCode
from appliance.screens.frame import alerts_top
from appliance.screens.painter import Painter, said_once
from appliance.screens.texts import worded
from appliance.screens.views import AimView, MenuView, ShutdownView
from tests.appliance.screens.golden.scenes import SCENES, alert
from tests.appliance.screens.test_legible import complaints, written

UNCALIBRATED = replace(alert(FaultCode.UNCALIBRATED), lasts=True)
MARK = replace(UNCALIBRATED, seen=True)
CRITICAL = alert(FaultCode.LASER_ON)
SHOWN: dict[str, tuple[Alert, ...]] = {
    "mark": (MARK,),
    "passing, and a mark": (alert(FaultCode.AIM_DARK), MARK),
    "in full": (UNCALIBRATED,),
    "in full, and a mark": (alert(FaultCode.STORAGE_FULL), MARK),
    "critical, and a mark": (CRITICAL, MARK),
}
BARE = {name: scene for name, scene in SCENES.items() if not isinstance(scene.view, ShutdownView)}
"""Switching off shows no alert but its own reason."""


@pytest.fixture(scope="module")
def painter(context: moderngl.Context) -> Iterator[Painter]:
    with Painter(context, (800, 480)) as made:
        yield made


@pytest.mark.parametrize("language", list(Language))
@pytest.mark.parametrize("shown", list(SHOWN))
def test_what_a_screen_says_and_shows_without_an_alert_it_says_and_shows_above_it(
    painter: Painter, shown: str, language: Language
) -> None:
    painter.language = language
    lost: dict[str, set[str]] = {}
    for name, scene in BARE.items():
        _, lines = written(painter, replace(scene.view, alerts=()), scene.time_s)
        slots = {slot for slot, *_ in painter.canvas.pictured}
        view = replace(scene.view, alerts=SHOWN[shown])
        _, now = written(painter, view, scene.time_s)
        missing = {line.words for line in lines} - {line.words for line in now}
        if isinstance(view, MenuView) and shown != "mark":
            # A long page scrolls by a row: the chosen one is there.
            assert view.rows[view.selected].text.in_language(language) not in missing
            missing = set() if len(view.rows) > 6 else missing
        if shown != "mark" and isinstance(view, AimView):
            missing.discard(Text.READY.in_language(language))  # what leads stands in its place
            if view.guidance is not None and view.guidance.words is not None:
                missing -= {worded(view.guidance.overlap or "", language)}  # what to do stays, how much may go
        missing |= slots - {slot for slot, *_ in painter.canvas.pictured}
        top = alerts_top(painter.canvas, said_once(view).alerts)
        missing |= {f"{slot} under it" for slot, _, _, _, bottom in painter.canvas.pictured if bottom > top + 0.5}
        missing |= set(complaints(painter.canvas, view, now, may_be_cut=False))
        if missing:
            lost[name] = missing
    assert not lost


@pytest.mark.parametrize("name", list(BARE))
def test_a_mark_costs_little_room_and_names_what_it_is(painter: Painter, name: str) -> None:
    painter.language = Language.ENGLISH
    view = replace(BARE[name].view, alerts=(MARK,))
    _, lines = written(painter, view, BARE[name].time_s)
    assert [line.words for line in lines].count("UNCALIBRATED") == 1
    assert painter.canvas.height - 62 - alerts_top(painter.canvas, (MARK,)) < 40
