"""Everything that is written can be read: large enough, with contrast in grey, whole, inside, and nothing over it, whatever stands in it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations, product

import moderngl
import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.calibrate.guide import HELD, RecordingCheck, Refusal, Session
from appliance.instrument.machine import events as on
from appliance.instrument.machine import keys as machine_keys
from appliance.instrument.machine.alerts import Alert, Severity, alert_of
from appliance.instrument.machine.choices import COLDEST_C, WARMEST_C
from appliance.instrument.machine.leading import alerts
from appliance.instrument.machine.menu import ROWS
from appliance.instrument.machine.states import Calibrating, Menu, Notice, NoticeKind, Page, Serving, Transfer, boot
from appliance.instrument.machine.words import Label, Language, Text, worded
from appliance.instrument.ranging.reach import Reach
from appliance.instrument.screens import theme
from appliance.instrument.screens.canvas import Canvas, TextLine
from appliance.instrument.screens.frame import alert_text, alerts_top, draw_alerts, draw_key_labels, room_between
from appliance.instrument.screens.painter import Painter, without_shown_alerts
from appliance.instrument.screens.views import AimView, AnyView, CalibrateView, Gauge, MenuView, ShutdownView
from appliance.instrument.service.view import Facts, menu_view
from appliance.measure.fault import Fault, FaultCode
from appliance.measure.light.exposure import Exposure, Span, ladder
from appliance.measure.verdict import Grade
from drivers.api import Key, KeyPress
from tests.appliance.instrument.machine.walks import STARTS, armed, in_gallery, reviewing, run
from tests.appliance.instrument.screens.golden.scenes import (
    AIM,
    ALERTS,
    GALLERY,
    REVIEW,
    SCENES,
    STORED,
    Scene,
    alert,
    keys,
)
from tests.support import news

DATA = {"fault", "self-test-failed"}
"""Scenes with words of others, which may be cut."""
Picture = NDArray[np.uint8]
BOTH = pytest.mark.parametrize("language", list(Language))


def written(painter: Painter, view: AnyView, time_s: float = 0.0) -> tuple[Picture, list[TextLine]]:
    picture = painter.draw(view, time_s).copy()
    return picture, list(painter.canvas.written)


def complaints(canvas: Canvas, view: AnyView, lines: list[TextLine], may_be_cut: bool) -> list[str]:
    """What an eye would object to; empty is good."""
    said = [f"smaller than a caption: {line}" for line in lines if line.size < theme.CAPTION]
    said += [f"cut: {line}" for line in lines if line.cut and not may_be_cut]
    said += [
        f"outside: {line}"
        for line in lines
        if line.left < 0 or line.top < 0 or line.right > canvas.width or line.bottom > canvas.height
    ]
    edge = alerts_top(canvas, without_shown_alerts(view).alerts)
    said += [f"half under an alert: {line}" for line in lines if view.alerts and line.top < edge - 1 < line.bottom - 2]
    said += [f"one over the other: {a.text!r} and {b.text!r}" for a, b in combinations(lines, 2) if overlap(a, b)]
    return said


def overlap(a: TextLine, b: TextLine) -> bool:
    return min(a.right, b.right) - max(a.left, b.left) > 0.5 and min(a.bottom, b.bottom) - max(a.top, b.top) > 0.5


def test_the_check_finds_what_it_should(painter: Painter) -> None:
    _, (a, b, *_) = written(painter, AIM)
    assert not complaints(painter.canvas, AIM, [a, b], may_be_cut=False)
    outside = replace(b, right=painter.canvas.width + 1)
    for wrong in ([a, replace(a, text="x")], [outside], [replace(b, size=20)], [replace(b, cut=True)]):
        assert complaints(painter.canvas, AIM, wrong, may_be_cut=False)


@BOTH
@pytest.mark.parametrize("size_px", [(1024, 600), (640, 480)])
def test_every_label_of_every_screen_fits_its_room_on_other_displays(
    context: moderngl.Context, size_px: tuple[int, int], language: Language
) -> None:
    found = {}
    with Painter(context, size_px, language) as painter:
        for name, scene in SCENES.items():
            _, lines = written(painter, scene.view, scene.time_s)
            assert lines or name == "reconstruct", name
            if said := complaints(painter.canvas, scene.view, lines, name in DATA):
                found[name] = said
    assert not found


def luminance(picture: Picture) -> NDArray[np.float64]:
    value = picture / 255.0
    linear = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    return np.asarray(linear @ np.array([0.2126, 0.7152, 0.0722]), np.float64)


def weak(painter: Painter, view: AnyView, time_s: float, share: float, patch: pytest.MonkeyPatch) -> dict[str, float]:
    """Words with too little contrast against what is really behind them: the ground is drawn without the letters."""
    _, lines = written(painter, view, time_s)
    with patch.context() as without:
        without.setattr(Canvas, "_stamp", lambda *_: None)
        painter.preview()  # drawn over, so that the view is drawn anew
        ground = painter.draw(view, time_s)
    found = {}
    for line in lines:
        behind = luminance(ground[int(line.top) : int(line.bottom) + 1, int(line.left) : int(line.right) + 1])
        light = line.colour.luminance
        contrast = (np.maximum(light, behind) + 0.05) / (np.minimum(light, behind) + 0.05)
        if (worst := float(np.percentile(contrast, share))) < theme.LEAST_CONTRAST:
            found[line.text] = round(worst, 1)
    return found


@pytest.mark.parametrize("time_s", [0.0, 0.6 / theme.FLASH_HZ])
def test_letters_stand_out_in_grey_whatever_the_cameras_show(
    painter: Painter, time_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, scene in SCENES.items():
        flashes = any(one.severity is Severity.CRITICAL for one in scene.view.alerts) or name.startswith("safe")
        if time_s == 0.0 or flashes:
            assert not weak(painter, scene.view, time_s, 2.0, monkeypatch), name
    white = np.full((300, 400), 255, np.uint8)
    view = AimView(
        left=white, right=white, scans_taken=1, scans_left=2, temperature_c=3.0, exposure="9 ms", water=Text.SALT
    )
    assert not weak(painter, view, time_s, 0.0, monkeypatch)


def test_the_smallest_capitals_are_two_millimetres_high(painter: Painter) -> None:
    """On the instrument's display of 5 inches, 108.6 mm across 800 px."""
    caption = next(line for line in written(painter, AIM)[1] if line.text == "SCANS")
    assert caption.size == theme.CAPTION
    assert (caption.bottom - caption.top) * 108.6 / 800 >= 2.0


PLACES = (None, "camera.left", "camera.right", "cameras")
NUMBERS: tuple[dict[str, float], ...] = (
    {},
    {
        "received": 0.0, "expected": 999.0, "shift_px": 999.9, "coverage_percent": 100.0, "temperature_c": 199.6,
        "supply_v": 99.94, "distance_mm": 9999.0, "error_percent": 99.9, "below_c": 57.0,
    },
    {
        "received": 123456.0, "expected": 123456.0, "shift_px": -12345.6, "coverage_percent": -0.4, "temperature_c": -99.6,
        "supply_v": 12345.6, "distance_mm": 123456.0, "error_percent": 12345.6, "below_c": 57.0,
    },
)  # fmt: skip


def every_alert() -> Iterator[Alert]:
    """Typical ones, and each fault at each place, with no numbers, large ones and absurd ones; alone, and as each kind of notice."""
    yield from ALERTS.values()
    for code, place, numbers in product(FaultCode, PLACES, NUMBERS):
        fault = Fault(code, "detail", numbers, place)
        yield alert_of(fault)
        for kind in NoticeKind if numbers is NUMBERS[1] and place is None else ():
            yield alerts(replace(boot(0), notice=Notice(replace(fault, detail="noticed"), kind)))[0]


@BOTH
def test_every_fault_with_every_number_is_whole_and_large_in_its_band(canvas: Canvas, language: Language) -> None:
    canvas.language = language
    told: set[tuple[str, str]] = set()
    for one in every_alert():
        words = one.german if language is Language.GERMAN and one.german else (one.headline, one.action)
        if words in told:
            continue
        told.add(words)
        canvas.begin(theme.INK)
        draw_alerts(canvas, (one,), 0.0)
        assert not any(line.cut for line in canvas.written), words
        if one.passing:  # a mark with what to do
            (line,) = canvas.written
            assert line.text == f"{words[0]}: {words[1]}"
            continue
        _, headline, action = canvas.written
        assert headline.size >= theme.TITLE, words
        assert action.size >= (theme.BODY if len(told) <= len(ALERTS) else theme.CAPTION + 4), words
        if one.detail == "noticed":
            continue
        canvas.begin(theme.INK)
        draw_alerts(canvas, (replace(one, is_acknowledged=True, lasts=True),), 0.0)
        assert not any(line.cut for line in canvas.written), words
    assert len(told) > 200


@BOTH
def test_many_alerts_are_named_or_counted(canvas: Canvas, language: Language) -> None:
    canvas.language = language
    for number in range(2, 9):
        canvas.begin(theme.INK)
        draw_alerts(canvas, tuple(ALERTS.values())[:number], 0.0)
        others = [line.text for line in canvas.written[:-3]]
        counted = [int(words) for words in others if words.startswith("+")]
        assert 0 < len(others) - len(counted) == number - 1 - sum(counted)
        assert max(line.right for line in canvas.written) <= canvas.width


UNCALIBRATED = replace(alert(FaultCode.UNCALIBRATED), lasts=True)
MARK = replace(UNCALIBRATED, is_acknowledged=True)
SHOWN: dict[str, tuple[Alert, ...]] = {
    "mark": (MARK,),
    "passing, and a mark": (alert(FaultCode.AIM_DARK), MARK),
    "in full, and a mark": (alert(FaultCode.STORAGE_FULL), MARK),
}


def lost_behind(
    painter: Painter, shown: str, scene: Scene, words: set[str], slots: set[str], language: Language
) -> set[str]:
    """What of a screen's words and pictures without an alert is not there, or not whole, above one."""
    view = replace(scene.view, alerts=SHOWN[shown])
    _, now = written(painter, view, scene.time_s)
    missing = words - {line.text for line in now}
    if isinstance(view, MenuView) and shown != "mark":
        # A long page scrolls by a row: the chosen one is there.
        assert view.rows[view.selected].text.in_language(language) not in missing
        missing = set() if len(view.rows) > 6 else missing
    if shown != "mark" and isinstance(view, AimView):
        missing.discard(Text.READY.in_language(language))  # what leads stands in its place
        if view.guidance is not None and view.guidance.instruction is not None:
            missing -= {worded(view.guidance.overlap or "", language)}  # what to do stays, how much may go
    missing |= slots - {slot for slot, *_ in painter.canvas.pictured}
    top = alerts_top(painter.canvas, without_shown_alerts(view).alerts)
    missing |= {f"{slot} under it" for slot, _, _, _, bottom in painter.canvas.pictured if bottom > top + 0.5}
    if shown == "mark":
        assert [line.text for line in now].count(alert_text(MARK, language)[0]) == 1
        assert painter.canvas.height - 62 - top < 40, "it costs little room"
    return missing | set(complaints(painter.canvas, view, now, may_be_cut=False))


@BOTH
def test_what_a_screen_says_and_shows_without_an_alert_it_says_and_shows_above_it(
    painter: Painter, language: Language
) -> None:
    painter.language = language
    for name, scene in SCENES.items():
        if isinstance(scene.view, ShutdownView):
            continue  # it shows no alert but its own reason
        _, lines = written(painter, replace(scene.view, alerts=()), scene.time_s)
        words, slots = {line.text for line in lines}, {slot for slot, *_ in painter.canvas.pictured}
        for shown in SHOWN if language is Language.GERMAN else ("in full, and a mark",):
            assert not lost_behind(painter, shown, scene, words, slots, language), (name, shown)


LADDER = ladder(60.0, 0, 0.0, Span(2.0, 16.0, 12.0))
LONGEST = max(LADDER, key=lambda step: len(step.label))
MOST: dict[str, AnyView] = {
    "aim, most": replace(
        AIM, scans_taken=98_765, scans_left=98_765, temperature_c=-12.6, exposure=LONGEST.label, water=Text.FRESH,
        gauge=Gauge(9999.0, -88.0, Reach.CLOSER),
    ),
    "aim, unknown": replace(AIM, gauge=Gauge(None, None, Reach.UNKNOWN)),
    "aim, back": replace(AIM, gauge=Gauge(104.0, 89.0, Reach.BACK), temperature_c=104.4, exposure="6.3 ms"),
    "review, most": replace(
        REVIEW, points=99_949_999, coverage_percent=100.0, noise_mm=12.3456, distance_mm=9_999.4, duration_s=12_345.67,
        grade=Grade.USABLE, lengths_doubtful=True,
    ),
    "review, bad": replace(REVIEW, points=999_499, grade=Grade.BAD, lengths_doubtful=True, coarse=True),
    "gallery, most": replace(
        GALLERY, index=99_998, count=99_999, scan=replace(
            STORED, scan_id="9999999", points=99_949_999, coverage_percent=100.0, noise_mm=12.3, distance_mm=9_999.0, grade=Grade.USABLE,
            lengths_doubtful=True, captured_at="2026-11-21T14:07:59+00:00",
        ),
    ),
    **{
        f"{step}, {refusal}": CalibrateView(
            position=Calibrating(step, latest=RecordingCheck(step, refusal, 47.123)), session=Session(), left=None, right=None,
            keys=keys(scan="SCAN", back="BACK"),
        )
        for step in HELD for refusal in Refusal
    },
}  # fmt: skip


@BOTH
def test_the_largest_and_the_smallest_numbers_fit(painter: Painter, language: Language) -> None:
    painter.language = language
    for name, view in MOST.items():
        _, lines = written(painter, view)
        assert not complaints(painter.canvas, view, lines, may_be_cut=False), name


TRANSFERS = (
    Transfer(Serving.ON, f"2001:db8:{'1' * 4}::{'2' * 4}:{'3' * 4}", 32),
    Transfer(Serving.FAILED, None, None),
    Transfer(Serving.ON, None, 0),
    Transfer(Serving.ON, "fe80::211:22ff:fe33:4455", 0),
)


@BOTH
@pytest.mark.parametrize("page", list(Page))
def test_every_row_of_every_page_of_the_menu_fits_with_every_value(
    painter: Painter, page: Page, language: Language
) -> None:
    painter.language = language
    facts = [Facts("KF-0123456789", Text.FROM_DRAWING), Facts("KF-1", "2026-11-02")]
    exposures = [*LADDER, Exposure(12_340, 3.25)]
    waters = [(salinity, celsius) for salinity in (0.0, 34.567, 42.0) for celsius in (COLDEST_C, 12.5, WARMEST_C)]
    rows = len(ROWS[page])
    for k in range(max(len(exposures), len(waters), rows)):
        salinity, celsius = waters[k % len(waters)]
        choices = replace(
            boot(0).choices, exposure=exposures[k % len(exposures)], salinity_psu=salinity, water_c=celsius,
            period_px=(16, 32, 64, 128)[k % 4], language=("en", "de")[k % 2], transfer=k % 3 > 0,
        )  # fmt: skip
        for draft in (None, choices):
            machine = replace(
                boot(0), choices=choices, menu=Menu(page, k % rows, draft), scans=98_765, scans_left=(98_765, None)[k % 2],
                transfer=TRANSFERS[k % len(TRANSFERS)],
            )  # fmt: skip
            view = menu_view(machine, facts[k % 2])
            _, lines = written(painter, view)
            assert not complaints(painter.canvas, view, lines, may_be_cut=False)


def moments() -> Iterator[tuple[str, dict[Key, Label]]]:
    """The labels of every moment, by its state or the question whether to switch off."""
    other = Exposure(8_000)
    more = (
        run(in_gallery(), KeyPress(Key.DOWN, 0)),
        run(reviewing(), news.judged(1, (Fault(FaultCode.TOO_BRIGHT),), other)),
        run(reviewing(), news.judged(1, (), None, other)),
        run(armed(), on.CaptureFailed(1, Fault(FaultCode.FRAME_MISSING))),
    )
    for machine in (*(start() for start in STARTS), *more):
        asked = machine.off_question is not None
        yield Text.POWER_OFF_ASKED.english if asked else machine.state.value, dict(machine_keys.labels(machine))


def labels() -> dict[Key, set[Label]]:
    """Every label of each key, with every step of every instrument's ladder behind EXPOSE and ADD."""
    found: dict[Key, set[Label]] = {key: set() for key in Key}
    for _, by_key in moments():
        for key, word in by_key.items():
            found[key].add(word)
    found[Key.BACK].add(Text.SEEN)
    steps = {
        step.label
        for refresh_hz, gain_db in product((24.0, 50.0, 60.0, 120.0), (0.0, 0.5, 3.25, 6.0))
        for step in ladder(refresh_hz, 0, gain_db, Span(2.0, 16.0, 24.0))
    }
    found[Key.DOWN] |= {(verb, step) for verb, step in product((Text.EXPOSE, Text.HOLD_ADD), steps)}
    found[Key.DOWN] |= {(Text.GAIN, step.partition(" +")[2]) for step in steps if " +" in step}
    # Stand-ins carry the labels of the keys that are stuck.
    found[Key.UP] |= found[Key.SCAN]
    found[Key.DOWN] |= found[Key.BACK]
    return found


@BOTH
def test_every_label_with_every_value_is_whole_large_enough_and_within_its_own_field(
    canvas: Canvas, language: Language
) -> None:
    canvas.language = language
    rooms: dict[Key, list[tuple[float, float]]] = {key: [] for key in Key}
    for key, shown in labels().items():
        for label in shown:
            canvas.begin(theme.INK)
            draw_key_labels(canvas, {key: label})
            left, right = room_between(canvas, {key: label}, theme.KEY_CORNERS[key][1])
            rooms[key].append((left, right))
            drawn = canvas.written
            assert not any("…" in line.text or line.cut for line in drawn), label
            for line in drawn:
                assert line.size >= theme.CAPTION, label
                assert 0 <= line.left <= line.right <= canvas.width, label
                assert line.right <= left or line.left >= right, label
                assert line.top >= canvas.height - 62 or line.bottom <= 62, label
            assert not any(min(a.bottom, b.bottom) - max(a.top, b.top) > 0.5 for a, b in combinations(drawn, 2)), label
    # Two side by side leave room between them for a scale.
    assert min(right for _, right in rooms[Key.BACK]) - max(left for left, _ in rooms[Key.DOWN]) > 260.0
    canvas.begin(theme.INK)
    draw_key_labels(canvas, {Key.DOWN: (Text.EXPOSE, "16 ms +12 dB")})
    assert [line.text for line in canvas.written] == [Text.EXPOSE.in_language(language), "16 ms +12 dB"]


@BOTH
def test_labels_keep_nearly_their_full_size(canvas: Canvas, language: Language) -> None:
    canvas.language = language
    plain = (Text.SCAN, Text.OK, Text.KEEP, Text.REPEAT, Text.BACK, Text.HOLD_OFF, Text.TURN, Text.SEEN, Text.RETRY)
    for text in plain:
        assert canvas.measure(text.in_language(language), theme.BODY, theme.BLACK) <= (theme.LABEL_MAX_PX - 48) / 0.8
