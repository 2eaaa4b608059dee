"""What is found out about a projector, from exposures of a model of it that sums bit planes over time."""

from __future__ import annotations

import functools
from dataclasses import replace

import pytest

from appliance.bringup.conclusions import conclusions, keys_of
from appliance.bringup.exposures import Trial
from appliance.bringup.finding import BringupError, Finding
from appliance.bringup.page import pictures_of, projector_page
from appliance.bringup.projector import ProjectorMeasured, measure_lines, measure_orientation, measure_projector
from appliance.bringup.rig_edit import with_keys
from appliance.config import default_rig_path, parse_rig
from tests.support.projector_model import PERIOD_US, Model, ModelBench, but, joined, planes_in, steady

pytestmark = pytest.mark.devices
PACKAGED = default_rig_path().read_text(encoding="utf-8")
STEADY = Model(steady())
VIDEO = Model(planes_in(5_000.0, 12_400.0), planes_in(500.0, 4_500.0), latency=1)
THIRD = PERIOD_US / 3.0
THIRDS = [planes_in(300.0 + k * THIRD, (k + 1) * THIRD) for k in range(3)]
PATTERN = Model(THIRDS[1], joined(THIRDS[0], THIRDS[2]), latency=1)


def measured(model: Model) -> tuple[ProjectorMeasured, dict[str, Finding]]:
    found = measure_projector(ModelBench(model), 12.0, lambda _what, _part: None)
    return found, named(found)


def named(found: ProjectorMeasured) -> dict[str, Finding]:
    return {one.name: one for one in conclusions(found, 60.0)}


@functools.cache
def steady_measured() -> ProjectorMeasured:
    return measured(STEADY)[0]


def seen_anew(model: Model, camera_px: tuple[int, int] = (96, 72)) -> dict[str, Finding]:
    """Return the findings of a steady lamp whose picture lies as that of ``model``."""
    bench, best = ModelBench(model, camera_px=camera_px), Trial(500, 10_000)
    seen, _ = measure_orientation(bench, 0, best, "green")
    lines, _ = measure_lines(bench, 0, best, "green")
    return named(replace(steady_measured(), seen=seen, lines=lines))


def wrong(findings: dict[str, Finding]) -> set[str]:
    return {name for name, one in findings.items() if not one.ok}


def test_a_steady_lamp_takes_every_exposure() -> None:
    found = steady_measured()
    assert wrong(named(found)) == set()
    assert (found.timing.latency_blanks, found.channels, found.sub_frames) == (0, "green", 1)
    assert found.offer is not None
    assert found.offer.exposures_us == (2000, 2500, 3200, 4000, 5000, 6300, 8000, 10000, 12000, 14000, 16000)
    assert found.timing.begins_us == pytest.approx(0.0, abs=50.0)
    assert found.timing.ends_us == pytest.approx(PERIOD_US, abs=100.0)


@pytest.mark.parametrize(("latency", "lag_us"), [(0, 0.0), (1, 0.0), (2, 300.0), (1, 6_000.0), (5, 0.0)])
def test_latency_is_known_in_blanks_and_the_rest_in_microseconds(latency: int, lag_us: float) -> None:
    found, findings = measured(but(STEADY, latency=latency, lag_us=lag_us))
    assert wrong(findings) == set()
    assert found.timing.latency_blanks == latency
    assert found.timing.begins_us == pytest.approx(lag_us, abs=60.0)
    rig = parse_rig(with_keys(PACKAGED, keys_of(found, 60.0, 12.0)))
    assert rig.projector.latency_blanks == latency
    # No exposure sees two pictures: it begins with the light or later, and ends with it.
    for time_ms in rig.scan.exposures_ms or ():
        assert rig.board.trigger_delay_us >= lag_us - 60.0
        assert rig.board.trigger_delay_us + 1000.0 * time_ms <= PERIOD_US + lag_us
    assert max(rig.scan.exposures_ms or ()) >= 14.0


def test_a_video_projector_is_only_exposed_for_the_whole_of_its_green() -> None:
    found, findings = measured(VIDEO)
    assert wrong(findings) == set()
    assert found.timing.latency_blanks == 1
    (window,) = found.timing.windows
    assert window.begins_us == pytest.approx(5_000.0, abs=250.0)
    assert window.ends_us == pytest.approx(12_400.0, abs=250.0)
    assert (found.channels, found.sub_frames) == ("green", 1), "red and blue are other colours, of another strength"
    assert found.offer is not None
    for time_us in found.offer.exposures_us:
        assert found.offer.delay_us <= 5_000
        assert found.offer.delay_us + time_us >= 12_400
    assert len(found.offer.exposures_us) == 1, "a longer one sees no more light"


def test_three_sub_frames_are_found_by_drawing_into_all_channels() -> None:
    found, findings = measured(PATTERN)
    assert wrong(findings) == set()
    assert (found.channels, found.sub_frames) == ("all", 3)
    rig = parse_rig(with_keys(PACKAGED, keys_of(found, 60.0, 12.0)))
    assert (rig.projector.channels, rig.projector.sub_frames, rig.projector.latency_blanks) == ("all", 3, 1)
    assert rig.scan.exposures_ms == (5.556, 11.111)
    assert rig.camera.left.exposure_ms == rig.camera.right.exposure_ms == 11.111


def test_no_offered_exposure_is_false() -> None:
    """Bit planes of every frame in an order of their own: what is offered is straight by arithmetic."""
    for order in ((7, 3, 5, 0, 6, 1, 4, 2), (0, 1, 2, 3, 4, 5, 6, 7), (4, 7, 1, 0, 6, 2, 5, 3)):
        for end_us in (9_000.0, 15_300.0):
            found, _ = measured(Model(planes_in(700.0, end_us, order)))
            assert found.offer is not None
            for time_us in found.offer.exposures_us:
                assert found.offer.delay_us <= 700.0 < end_us <= found.offer.delay_us + time_us + 40.0, (order, end_us)


def test_light_that_fills_more_than_an_exposure_holds_is_refused_with_a_remedy() -> None:
    found, findings = measured(Model(planes_in(0.0, PERIOD_US)))
    assert found.offer is None
    assert wrong(findings) == {"grey"}
    assert "bit planes" in findings["grey"].said
    assert "pattern mode" in findings["grey"].remedy
    with pytest.raises(ValueError, match="no exposure is good"):
        keys_of(found, 60.0, 12.0)


@pytest.mark.parametrize("power", [2.2, 0.45])
def test_a_gamma_is_named_with_its_exponent(power: float) -> None:
    _, findings = measured(but(STEADY, gamma=power))
    assert wrong(findings) == {"grey"}
    assert f"a power of {power:.1f}" in findings["grey"].said or power < 1.0
    assert "switch gamma off" in findings["grey"].remedy


def test_a_gamma_behind_equal_sub_frames_is_named_as_such() -> None:
    half_us = PERIOD_US / 2.0
    twice = joined(*(planes_in(120.0 + k * half_us, (k + 1) * half_us - 80.0) for k in range(2)))
    found, findings = measured(Model(twice, latency=1, gamma=2.2))
    assert found.sub_frames == 2
    assert wrong(findings) == {"grey"}
    assert "a power of 2.2" in findings["grey"].said
    assert "switch gamma off" in findings["grey"].remedy


def test_a_restless_lamp_is_named() -> None:
    _, findings = measured(but(STEADY, unrest=0.05))
    assert wrong(findings) >= {"grey"}
    assert "restless" in findings["grey"].said


@pytest.mark.parametrize("scale", [0.9, 1.1, 1.25, 1.875])
def test_a_picture_that_is_scaled_beats(scale: float) -> None:
    findings = seen_anew(but(STEADY, scale=scale))
    assert wrong(findings) == {"raster"}
    assert "scales its picture" in findings["raster"].said
    assert "raster of its panel" in findings["raster"].remedy
    findings = seen_anew(STEADY)
    assert wrong(findings) == set()
    assert findings["raster"].said.startswith("single lines are equally bright")


def test_coarse_cameras_do_not_judge_the_raster() -> None:
    findings = seen_anew(STEADY, (40, 30))
    assert findings["raster"].ok
    assert "cannot be told" in findings["raster"].said


@pytest.mark.parametrize(
    ("mirrored", "upside_down", "said", "remedy"),
    [
        (True, False, "mirrored left to right", "rear projection"),
        (False, True, "mirrored top to bottom", "vertical flip"),
        (True, True, "turned by 180°", "ceiling projection"),
    ],
)
def test_a_picture_that_lies_wrong_is_named(mirrored: bool, upside_down: bool, said: str, remedy: str) -> None:
    findings = seen_anew(but(STEADY, mirrored=mirrored, upside_down=upside_down))
    assert wrong(findings) == {"orientation"}, "whoever mirrors exchanges no cameras"
    assert said in findings["orientation"].said
    assert remedy in findings["orientation"].remedy


def test_exchanged_cameras_are_named() -> None:
    findings = seen_anew(STEADY)
    assert findings["sides"].said == "left and right are as in the rig file"
    findings = seen_anew(but(STEADY, exchanged=True))
    assert wrong(findings) == {"sides"}
    assert "exchange the serials" in findings["sides"].remedy


def test_exchanged_cameras_before_a_mirrored_picture_are_both_named() -> None:
    assert wrong(seen_anew(but(STEADY, mirrored=True, exchanged=True))) == {"orientation", "sides"}


def test_a_camera_that_exposes_late_is_named() -> None:
    found, findings = measured(but(VIDEO, late_us={"right": 300.0}))
    assert wrong(findings) == {"skew"}
    assert found.skew_us == pytest.approx(-300.0, abs=20.0)
    assert "the right one later" in findings["skew"].said


@pytest.mark.parametrize(
    ("model", "said"),
    [
        (but(STEADY, white_dn_per_ms=0.05), r"one white picture among black ones changed the images by"),
        (but(STEADY, latency=7), r"7 vertical blanks after its flip; allowed are 0\.\.5"),
    ],
)
def test_what_cannot_be_measured_is_said_at_once(model: Model, said: str) -> None:
    bench = ModelBench(model)
    with pytest.raises(BringupError, match=said):
        measure_projector(bench, 12.0, lambda _what, _part: None)
    assert bench.takes == 1


def test_a_rate_beyond_the_boards_delay_is_refused() -> None:
    bench = ModelBench(STEADY, refresh_hz=24.0)
    with pytest.raises(BringupError, match=r"projector\.refresh_hz 24: allowed here are 35\.\.240"):
        measure_projector(bench, 12.0, lambda _what, _part: None)


def test_the_page_has_every_finding_and_all_pictures_in_it() -> None:
    found = replace(steady_measured(), skew_us=100.0)
    findings = named(found)
    pictures = pictures_of(found, PERIOD_US)
    assert set(pictures) == {
        "light.png",
        "grey.png",
        "marker_left.png",
        "marker_right.png",
        "checker_left.png",
        "checker_right.png",
    }
    assert all(data.startswith(b"\x89PNG") for _, data in pictures.values())
    page = projector_page(list(findings.values()), {}, found, pictures)
    assert page.count('class="no">WRONG') == 1
    assert page.count("data:image/png;base64,") == len(pictures)
    assert all(name in page for name in findings)
    assert "http" not in page
