"""What is found out about a projector, from exposures of a model of it that sums bit planes over time."""

from __future__ import annotations

import functools
from dataclasses import replace

import pytest

from appliance.base import silent
from appliance.store.config import default_rig_path, parse_rig
from appliance.workshop.bench import Shot
from appliance.workshop.finding import BringupError, Finding
from appliance.workshop.light import keys_of
from appliance.workshop.projector import ProjectorMeasurement, measure_projector
from appliance.workshop.raster import measure_lines, measure_orientation
from appliance.workshop.rig_edit import with_keys
from tests.appliance.workshop.scripted import projector_findings
from tests.support.projector_model import PERIOD_US, Model, ModelBench, but, joined, planes_in, steady

pytestmark = pytest.mark.devices
PACKAGED = default_rig_path().read_text(encoding="utf-8")
STEADY = Model(steady())
VIDEO = Model(planes_in(5_000.0, 12_400.0), planes_in(500.0, 4_500.0), latency=1)


def measured(model: Model) -> tuple[ProjectorMeasurement, dict[str, Finding]]:
    found = measure_projector(ModelBench(model), 12.0, silent)
    return found, projector_findings(found)


@functools.cache
def steady_measured() -> ProjectorMeasurement:
    return measured(STEADY)[0]


def seen_anew(model: Model) -> dict[str, Finding]:
    """Return the findings of a steady lamp whose picture lies as that of ``model``."""
    bench, shot = ModelBench(model), Shot(500, 10_000)
    seen, _ = measure_orientation(bench, shot, all_channels=False)
    lines, _ = measure_lines(bench, shot, all_channels=False)
    return projector_findings(replace(steady_measured(), views=seen, lines=lines))


def wrong(findings: dict[str, Finding]) -> set[str]:
    return {name for name, one in findings.items() if not one.ok}


@pytest.mark.parametrize(("latency", "lag_us"), [(2, 300.0), (1, 6_000.0)])
def test_latency_is_known_in_blanks_and_the_rest_in_microseconds(latency: int, lag_us: float) -> None:
    found, findings = measured(but(STEADY, latency=latency, lag_us=lag_us))
    assert wrong(findings) == set()
    assert found.lamp.timing.latency_blanks == latency
    assert found.lamp.timing.begins_us == pytest.approx(lag_us, abs=60.0)
    rig = parse_rig(with_keys(PACKAGED, keys_of(found.lamp, PERIOD_US, 12.0)))
    assert rig.projector.latency_blanks == latency
    # No exposure sees two pictures: it begins with the light or later, and ends with it.
    times_us, delay_us = [1000.0 * ms for ms in rig.scan.exposures_ms or ()], rig.board.trigger_delay_us
    assert delay_us >= lag_us - 60.0
    assert 14_000.0 <= max(times_us) <= PERIOD_US + lag_us - delay_us


def test_no_offered_exposure_is_false() -> None:
    found, _ = measured(Model(planes_in(700.0, 9_000.0, (7, 3, 5, 0, 6, 1, 4, 2))))
    assert found.lamp.offer is not None
    for time_us in found.lamp.offer.exposures_us:
        assert found.lamp.offer.delay_us <= 700.0 < 9_000.0 <= found.lamp.offer.delay_us + time_us + 40.0


def test_a_gamma_behind_equal_sub_frames_is_named_as_such() -> None:
    half_us = PERIOD_US / 2.0
    twice = joined(*(planes_in(120.0 + k * half_us, (k + 1) * half_us - 80.0) for k in range(2)))
    found, findings = measured(Model(twice, latency=1, gamma=2.2))
    assert found.lamp.sub_frames == 2
    assert wrong(findings) == {"grey"}
    assert "a power of 2.2" in findings["grey"].said


@pytest.mark.parametrize(
    ("changes", "names", "said"),
    [
        ({"mirrored": True}, {"orientation"}, "mirrored left to right"),  # whoever mirrors exchanges no cameras
        ({"upside_down": True}, {"orientation"}, "mirrored top to bottom"),
        ({"mirrored": True, "upside_down": True}, {"orientation"}, "turned by 180°"),
        ({"exchanged": True}, {"sides"}, ""),
        ({"mirrored": True, "exchanged": True}, {"orientation", "sides"}, "mirrored left to right"),
    ],
)
def test_a_picture_that_lies_wrong_and_exchanged_cameras_are_named(
    changes: dict[str, bool], names: set[str], said: str
) -> None:
    findings = seen_anew(but(STEADY, **changes))
    assert wrong(findings) == names
    assert said in findings["orientation"].said


def test_a_camera_that_exposes_late_is_named() -> None:
    found, findings = measured(but(VIDEO, late_us={"right": 300.0}))
    assert wrong(findings) == {"skew"}
    assert found.skew_us == pytest.approx(-300.0, abs=20.0)


@pytest.mark.parametrize(
    ("bench", "takes", "said"),
    [
        (ModelBench(but(STEADY, white_dn_per_ms=0.05)), 1, r"one white picture among black ones changed the images by"),
        (ModelBench(but(STEADY, latency=7)), 1, r"7 vertical blanks after its flip; allowed are 0\.\.5"),
        (ModelBench(STEADY, refresh_hz=24.0), 0, r"projector\.refresh_hz 24: allowed here are 35\.\.240"),
    ],
)
def test_what_cannot_be_measured_is_said_at_once(bench: ModelBench, takes: int, said: str) -> None:
    with pytest.raises(BringupError, match=said):
        measure_projector(bench, 12.0, silent)
    assert bench.takes == takes
