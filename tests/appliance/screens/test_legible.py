"""Everything that is written can be read: large enough, with contrast in grey, whole, inside, and nothing over it."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import moderngl
import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.calibration.guide import HELD, RecordingCheck, Refusal, Session, Step
from appliance.machine.states import Calibrating
from appliance.machine.words import Language, Text
from appliance.screens import theme
from appliance.screens.canvas import Canvas, Written
from appliance.screens.frame import alerts_top, draw_alerts
from appliance.screens.painter import Painter, said_once
from appliance.screens.views import AnyView, CalibrateView
from tests.appliance.screens.golden.scenes import AIM, ALERTS, SCENES, keys

SIZES_PX = ((800, 480), (1024, 600), (640, 480))
DATA = {"fault", "self-test-failed"}
"""Scenes with words of others, which may be cut."""
Picture = NDArray[np.uint8]


@pytest.fixture(scope="module", params=SIZES_PX, ids=lambda size: f"{size[0]}x{size[1]}")
def one_size(request: pytest.FixtureRequest, context: moderngl.Context) -> Iterator[Painter]:
    with Painter(context, request.param) as made:
        yield made


@pytest.fixture(scope="module")
def painter(context: moderngl.Context) -> Iterator[Painter]:
    """Of the display's own size, kept for the whole file: opening one costs more than a picture."""
    with Painter(context, SIZES_PX[0]) as made:
        yield made


def written(painter: Painter, view: AnyView, time_s: float = 0.0) -> tuple[Picture, list[Written]]:
    picture = painter.draw(view, time_s).copy()
    return picture, list(painter.canvas.written)


def without_letters(painter: Painter, view: AnyView, time_s: float, monkeypatch: pytest.MonkeyPatch) -> Picture:
    with monkeypatch.context() as patch:
        patch.setattr(Canvas, "_stamp", lambda *_: None)
        return painter.draw(view, time_s).copy()


def complaints(canvas: Canvas, view: AnyView, lines: list[Written], may_be_cut: bool) -> list[str]:
    """What an eye would object to; empty is good."""
    said = [f"smaller than a caption: {line}" for line in lines if line.size < theme.CAPTION]
    said += [f"cut: {line}" for line in lines if line.cut and not may_be_cut]
    said += [
        f"outside: {line}"
        for line in lines
        if line.left < 0 or line.top < 0 or line.right > canvas.width or line.bottom > canvas.height
    ]
    edge = alerts_top(canvas, said_once(view).alerts)
    said += [f"half under an alert: {line}" for line in lines if view.alerts and line.top < edge - 1 < line.bottom - 2]
    said += [
        f"one over the other: {a.words!r} and {b.words!r}"
        for a, b in combinations(lines, 2)
        if min(a.right, b.right) - max(a.left, b.left) > 0.5 and min(a.bottom, b.bottom) - max(a.top, b.top) > 0.5
    ]
    return said


@pytest.mark.parametrize("language", list(Language))
def test_every_label_of_every_screen_fits_its_room(one_size: Painter, language: Language) -> None:
    one_size.language = language
    found = {}
    for name, scene in SCENES.items():
        _, lines = written(one_size, scene.view, scene.time_s)
        assert lines or name == "reconstruct", name
        if said := complaints(one_size.canvas, scene.view, lines, name in DATA):
            found[name] = said
    assert not found


@pytest.mark.parametrize("language", list(Language))
def test_every_alert_keeps_a_size_that_is_seen_at_once(context: moderngl.Context, language: Language) -> None:
    """Headlines are never smaller than a title, actions never smaller than body type, in the band of any screen."""
    with context:
        canvas = Canvas(context, (800, 480))
        for alert in ALERTS.values():
            if alert.passing:
                continue  # never in full
            canvas.begin(theme.INK)
            draw_alerts(canvas, (alert,), language, 0.0)
            _, headline, action = canvas.written
            assert headline.size >= theme.TITLE, headline
            assert action.size >= theme.BODY, action
            assert not headline.cut
            assert not action.cut
        canvas.close()


@pytest.mark.parametrize("language", list(Language))
def test_many_alerts_are_named_or_counted(context: moderngl.Context, language: Language) -> None:
    with context:
        canvas = Canvas(context, (800, 480))
        for number in range(2, 9):
            canvas.begin(theme.INK)
            shown = tuple(ALERTS.values())[:number]
            draw_alerts(canvas, shown, language, 0.0)
            others = canvas.written[:-3]
            named = [line for line in others if not line.words.startswith("+")]
            counted = [int(line.words) for line in others if line.words.startswith("+")]
            assert len(named) + sum(counted) == number - 1
            assert named
            assert max(line.right for line in others) <= canvas.width
        canvas.close()


@pytest.mark.parametrize("language", list(Language))
@pytest.mark.parametrize("step", list(HELD))
def test_every_reason_of_the_calibration_fits(painter: Painter, step: Step, language: Language) -> None:
    painter.language = language
    for refusal in Refusal:
        at = Calibrating(step, latest=RecordingCheck(step, refusal, 47.123))
        view = CalibrateView(at=at, session=Session(), left=None, right=None, keys=keys(scan="SCAN", back="BACK"))
        painter.draw(view, 0.0)
        assert not complaints(painter.canvas, view, painter.canvas.written, may_be_cut=False)


@pytest.mark.parametrize("time_s", [0.0, 0.6 / theme.FLASH_HZ])
@pytest.mark.parametrize("name", list(SCENES))
def test_letters_stand_out_in_grey(painter: Painter, name: str, time_s: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Against what is really behind them, whatever the cameras show: the ground is drawn without the letters."""
    painter.language = Language.ENGLISH
    view = SCENES[name].view
    _, lines = written(painter, view, time_s)
    ground = luminance(without_letters(painter, view, time_s, monkeypatch))
    weak = {}
    for line in lines:
        behind = ground[int(line.top) : int(line.bottom) + 1, int(line.left) : int(line.right) + 1]
        light = line.colour.luminance
        contrast = (np.maximum(light, behind) + 0.05) / (np.minimum(light, behind) + 0.05)
        if (worst := float(np.percentile(contrast, 2))) < theme.LEAST_CONTRAST:
            weak[line.words] = round(worst, 1)
    assert not weak


def luminance(picture: Picture) -> NDArray[np.float64]:
    value = picture / 255.0
    linear = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    return np.asarray(linear @ np.array([0.2126, 0.7152, 0.0722]), np.float64)


def test_white_pictures_do_not_drown_what_is_written_on_them(painter: Painter, monkeypatch: pytest.MonkeyPatch) -> None:
    painter.language = Language.ENGLISH
    white = np.full((300, 400), 255, np.uint8)
    view = type(AIM)(
        left=white, right=white, scans_taken=1, scans_left=2, temperature_c=3.0, exposure="9 ms", water=Text.SALT
    )
    _, lines = written(painter, view)
    ground = luminance(without_letters(painter, view, 0.0, monkeypatch))
    on_pictures = [line for line in lines if 120 < line.top < 400]
    assert {line.words for line in on_pictures} >= {"L", "R", "9 ms", "SALT", "HOUSING 3 °C"}
    for line in on_pictures:
        behind = ground[int(line.top) : int(line.bottom) + 1, int(line.left) : int(line.right) + 1]
        assert (line.colour.luminance + 0.05) / (behind.max() + 0.05) >= theme.LEAST_CONTRAST


def test_the_smallest_capitals_are_two_millimetres_high(painter: Painter) -> None:
    """On the instrument's display of 5 inches, 108.6 mm across 800 px."""
    painter.language = Language.ENGLISH
    painter.draw(AIM, 0.0)
    caption = next(line for line in painter.canvas.written if line.words == "SCANS")
    assert caption.size == theme.CAPTION
    assert (caption.bottom - caption.top) * 108.6 / 800 >= 2.0


def test_the_check_finds_what_it_should(painter: Painter) -> None:
    """Words that are moved onto others, out of the picture, or made small are complained of."""
    _, lines = written(painter, AIM)
    canvas = painter.canvas
    assert not complaints(canvas, AIM, lines, may_be_cut=False)
    a, b = lines[0], lines[1]
    assert complaints(canvas, AIM, [a, type(a)("x", a.left, a.top, a.right, a.bottom, 30, a.colour, False)], False)
    assert complaints(
        canvas, AIM, [type(b)("x", b.left, b.top, canvas.width + 1, b.bottom, 30, b.colour, False)], False
    )
    assert complaints(canvas, AIM, [type(b)("x", b.left, b.top, b.right, b.bottom, 20, b.colour, False)], False)
    assert complaints(canvas, AIM, [type(b)("x…", b.left, b.top, b.right, b.bottom, 24, b.colour, True)], False)
