"""Whatever number, place or reason stands in it, no text of a screen is cut, too small, or written over another."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import product

import moderngl
import pytest

from appliance.machine.alerts import Alert, alert_of
from appliance.machine.choices import COLDEST_C, WARMEST_C
from appliance.machine.leading import alerts
from appliance.machine.menu import ROWS
from appliance.machine.states import Menu, Notice, NoticeKind, Page, boot
from appliance.machine.transfer import Serving, Transfer
from appliance.machine.words import Language, Text
from appliance.ranging.reach import Reach
from appliance.scan.exposure import Exposure, Span, ladder
from appliance.scan.fault import Fault, FaultCode
from appliance.scan.grade import Grade
from appliance.screens import theme
from appliance.screens.canvas import Canvas
from appliance.screens.frame import draw_alerts
from appliance.screens.painter import Painter
from appliance.screens.views import AnyView, Gauge
from appliance.service.menu_view import Facts, menu_view
from tests.appliance.screens.golden.scenes import AIM, GALLERY, REVIEW
from tests.appliance.screens.test_legible import complaints, written

PLACES = (None, "camera.left", "camera.right", "cameras", "board", "case", "projector")
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
LONGEST = max((step for step in ladder(60.0, 0, 0.0, Span(2.0, 16.0, 12.0))), key=lambda step: len(step.label))


def every_alert() -> Iterator[Alert]:
    """Each fault at each place, with no numbers, large ones and absurd ones; alone, and as each kind of notice."""
    for code, place, numbers in product(FaultCode, PLACES, NUMBERS):
        fault = Fault(code, "detail", numbers, place)
        yield alert_of(fault)
        for kind in NoticeKind:
            yield alerts(replace(boot(0), notice=Notice(fault, kind)))[0]


@pytest.fixture(scope="module")
def painter(context: moderngl.Context) -> Iterator[Painter]:
    with Painter(context, (800, 480)) as made:
        yield made


@pytest.mark.parametrize("language", list(Language))
def test_every_fault_with_every_number_is_whole_and_large_in_its_band(
    context: moderngl.Context, language: Language
) -> None:
    told: set[tuple[str, str]] = set()
    with context:
        canvas = Canvas(context, (800, 480))
        for alert in every_alert():
            words = alert.german if language is Language.GERMAN and alert.german else (alert.headline, alert.action)
            if words in told:
                continue
            told.add(words)
            canvas.begin(theme.INK)
            draw_alerts(canvas, (alert,), language, 0.0)
            if alert.passing:  # a mark with what to do
                (line,) = canvas.written
                assert line.words == f"{words[0]}: {words[1]}"
                assert not line.cut
                continue
            _, headline, action = canvas.written
            assert not headline.cut, words
            assert not action.cut, words
            assert headline.size >= theme.TITLE, words
            assert action.size >= theme.CAPTION + 4, words
            canvas.begin(theme.INK)
            draw_alerts(canvas, (replace(alert, seen=True, lasts=True),), language, 0.0)
            assert not any(line.cut for line in canvas.written), words
        canvas.close()
    assert len(told) > 200


def views() -> dict[str, AnyView]:
    """Screens with the largest and the smallest of everything."""
    tens_of_thousands = 98_765
    return {
        "aim, most": replace(
            AIM, scans_taken=tens_of_thousands, scans_left=tens_of_thousands, temperature_c=-12.6, exposure=LONGEST.label,
            water=Text.FRESH, gauge=Gauge(9999.0, -88.0, Reach.CLOSER),
        ),
        "aim, unknown": replace(AIM, gauge=Gauge(None, None, Reach.UNKNOWN)),
        "aim, back": replace(AIM, gauge=Gauge(104.0, 89.0, Reach.BACK), temperature_c=104.4, exposure="6.3 ms"),
        "review, most": replace(
            REVIEW, points=99_949_999, coverage_percent=100.0, noise_mm=12.3456, distance_mm=9_999.4, duration_s=12_345.67,
            grade=Grade.USABLE, lengths_doubtful=True,
        ),
        "review, bad": replace(REVIEW, points=999_499, grade=Grade.BAD, lengths_doubtful=True, coarse=True),
        "gallery, most": replace(
            GALLERY, scan_id="9999999", index=99_998, count=99_999, points=99_949_999, coverage_percent=100.0, noise_mm=12.3,
            distance_mm=9_999.0, grade=Grade.USABLE, lengths_doubtful=True, taken="2026-11-21T14:07:59+00:00",
        ),
    }  # fmt: skip


@pytest.mark.parametrize("language", list(Language))
@pytest.mark.parametrize("name", list(views()))
def test_the_largest_and_the_smallest_numbers_fit(painter: Painter, name: str, language: Language) -> None:
    painter.language = language
    view = views()[name]
    _, lines = written(painter, view)
    assert not complaints(painter.canvas, view, lines, may_be_cut=False)


TRANSFERS = (
    Transfer(Serving.ON, f"2001:db8:{'1' * 4}::{'2' * 4}:{'3' * 4}", 32),
    Transfer(Serving.FAILED, None, None),
    Transfer(Serving.ON, None, 0),
    Transfer(Serving.ON, "fe80::211:22ff:fe33:4455", 0),
)


@pytest.mark.parametrize("language", list(Language))
@pytest.mark.parametrize("page", list(Page))
def test_every_row_of_every_page_of_the_menu_fits_with_every_value(
    painter: Painter, page: Page, language: Language
) -> None:
    painter.language = language
    start = boot(0)
    facts = [Facts("KF-0123456789", Text.FROM_DRAWING), Facts("KF-1", "2026-11-02")]
    exposures = [*ladder(60.0, 0, 0.0, Span(2.0, 16.0, 12.0)), Exposure(12_340, 3.25)]
    waters = [(salinity, celsius) for salinity in (0.0, 34.567, 42.0) for celsius in (COLDEST_C, 12.5, WARMEST_C)]
    for row in range(len(ROWS[page])):
        for k in range(max(len(exposures), len(waters))):
            salinity, celsius = waters[k % len(waters)]
            choices = replace(
                start.choices, exposure=exposures[k % len(exposures)], salinity_psu=salinity, water_c=celsius,
                period_px=(16, 32, 64, 128)[k % 4], language=("en", "de")[k % 2], transfer=k % 3 > 0,
            )  # fmt: skip
            for draft in (None, choices):
                machine = replace(
                    start,
                    choices=choices,
                    menu=Menu(page, row, draft),
                    scans=98_765,
                    scans_left=(98_765, None)[k % 2],
                    transfer=TRANSFERS[k % len(TRANSFERS)],
                )
                view = menu_view(machine, facts[k % 2])
                _, lines = written(painter, view)
                said = complaints(painter.canvas, view, lines, may_be_cut=False)
                assert not said, said
