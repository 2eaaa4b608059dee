"""Every number of the rig file: what it may be, both ends included, and what it is where the file does not say."""

from __future__ import annotations

import math
import re
import tomllib
from contextlib import nullcontext
from dataclasses import replace
from typing import Any

import pytest
from pydantic import ValidationError

from appliance.instrument.service.settings import machine_settings, standard_choices
from appliance.measure.light.exposure import Exposure
from appliance.store.config import ConfigError, default_rig_path, parse_rig
from appliance.store.config.rig import LimitsRig
from appliance.store.instrument import Instrument

PACKAGED = default_rig_path().read_text(encoding="utf-8")
RIG = parse_rig(PACKAGED)
RANGES: dict[str, tuple[float, float]] = {
    "camera.left.width_px": (64, 8192), "camera.left.height_px": (64, 8192), "camera.left.exposure_ms": (0.05, 16.6),
    "camera.left.gain_db": (0.0, 48.0), "camera.left.full_well_e": (500.0, 1e6), "camera.left.read_noise_e": (0.0, 1e3),
    "camera.left.black_level_dn": (0.0, 64.0),
    "board.trigger_delay_us": (0, 15_000), "board.live_every_vsyncs": (1, 60),
    "board.vendor_id": (0, 0xFFFF), "board.product_id": (0, 0xFFFF), "keys.vendor_id": (0, 0xFFFF), "keys.product_id": (0, 0xFFFF),
    "projector.width_px": (64, 8192), "projector.height_px": (64, 8192), "projector.refresh_hz": (1.0, 240.0),
    "scan.shortest_exposure_ms": (0.05, 10.0), "scan.longest_exposure_ms": (2.0, 16.6), "scan.most_gain_db": (0.0, 48.0),
    "water.salinity_psu": (0.0, 45.0), "water.temperature_c": (-2.0, 40.0), "water.wavelength_nm": (400.0, 700.0),
    "storage.reserve_mb": (0, 1_000_000),
    "design.principal_distance_mm": (1.0, 500.0), "design.pixel_um": (0.5, 100.0), "design.baseline_mm": (10.0, 2000.0),
    "design.toe_in_deg": (-45.0, 45.0), "design.port_distance_mm": (0.0, 500.0), "design.port_thickness_mm": (0.0, 50.0),
    "design.port_index": (1.0, 3.0), "design.projector_principal_distance_mm": (1.0, 500.0),
    "design.projector_pixel_um": (0.5, 100.0),
    "lasers.x_mm": (0.0, 500.0), "lasers.y_mm": (-500.0, 500.0), "lasers.z_mm": (-200.0, 300.0),
    "lasers.aim_x_mm": (0.0, 200.0), "lasers.aim_y_mm": (-200.0, 200.0), "lasers.aim_z_mm": (50.0, 3000.0),
    "lasers.tolerance_deg": (0.01, 1.0),
    "limits.case_warm_c": (0.0, 100.0), "limits.case_hot_c": (0.0, 100.0), "limits.case_off_c": (0.0, 110.0),
    "limits.projector_warm_c": (0.0, 120.0), "limits.projector_hot_c": (0.0, 120.0), "limits.projector_off_c": (0.0, 130.0),
    "limits.supply_low_v": (0.0, 60.0),
    "ball_bar.length_mm": (20.0, 1000.0), "ball_bar.length_sd_mm": (0.0001, 1.0), "ball_bar.radius_mm": (5.0, 40.0),
    "ball_bar.radius_sd_mm": (0.0001, 1.0),
    "volume.nearest_mm": (50.0, 3000.0), "volume.working_mm": (50.0, 3000.0), "volume.farthest_mm": (50.0, 3000.0),
}  # fmt: skip
OPTIONAL = {
    "full_well_e": 13_000.0, "read_noise_e": 20.0, "black_level_dn": 2.0, "shortest_exposure_ms": 2.0,
    "longest_exposure_ms": 16.0, "most_gain_db": 12.0, "reserve_mb": 500, "tolerance_deg": 0.3,
    "nearest_mm": 440.0, "working_mm": 500.0, "farthest_mm": 560.0,
}  # fmt: skip
"""Keys of the packaged file that may be left out, and what they are then."""


def with_key(key: str, value: float) -> Any:
    """Return the key's table with another value. Raises ValidationError for one that it may not have."""
    table: Any = RIG
    *tables, name = key.split(".")
    for one in tables:
        table = getattr(table, one)
    return replace(table, **{name: value})


@pytest.mark.parametrize("key", RANGES)
def test_a_number_is_taken_up_to_both_ends_of_its_range_and_refused_beyond(key: str) -> None:
    least, most = RANGES[key]
    name = key.rpartition(".")[2]
    for value in (least, most):
        assert getattr(with_key(key, value), name) == value
    whole = isinstance(least, int)
    beyond = (least - 1, most + 1) if whole else (math.nextafter(least, -math.inf), math.nextafter(most, math.inf))
    for value in beyond:
        with pytest.raises(ValidationError):
            with_key(key, value)


def test_what_may_be_left_out_is_then_what_the_packaged_file_says() -> None:
    lines = [line for line in PACKAGED.splitlines() if line.split("=")[0].strip() not in OPTIONAL]
    assert len(PACKAGED.splitlines()) - len(lines) == len(OPTIONAL) + 3, "three of them for each camera"
    assert parse_rig("\n".join(lines)) == RIG
    tables = tomllib.loads(PACKAGED)
    said: dict[str, object] = {}
    for table in (*tables.values(), *tables["camera"].values()):
        said |= table if isinstance(table, dict) else {}
    assert {name: said[name] for name in OPTIONAL} == OPTIONAL


def test_without_limits_of_its_own_a_housing_has_cautious_ones() -> None:
    head, _, rest = PACKAGED.partition("[limits]")
    without = parse_rig(head + rest[rest.index("\n[") :])
    assert without.limits == LimitsRig(50.0, 60.0, 68.0, 65.0, 75.0, 85.0, None)


@pytest.mark.parametrize("part", ["case", "projector"])
def test_it_warns_then_stops_then_goes_off_and_no_two_of_these_at_once(part: str) -> None:
    head, _, rest = PACKAGED.partition("[limits]")
    rest = rest[rest.index("\n[") :]

    for warm_c, off_c, said in (
        (40.0, 41.0, ""),
        (40.5, 41.0, f"limits.{part}_warm_c 40.5 >= 40.5; allowed: below {part}_hot_c;"),
        (40.0, 40.5, f"limits.{part}_off_c 40.5 <= 40.5; allowed: above {part}_hot_c;"),
    ):
        numbers = f"{part}_warm_c = {warm_c}\n{part}_hot_c = 40.5\n{part}_off_c = {off_c}\n"
        with pytest.raises(ConfigError, match=re.escape(said)) if said else nullcontext():
            parse_rig(f"{head}[limits]\n{numbers}{rest}")


def test_the_longest_exposure_that_a_refusal_names_is_taken_itself() -> None:
    """A period of 16.67 ms less a delay of 6 ms: 10.66 ms, rounded down."""
    slow = PACKAGED.replace("trigger_delay_us = 500", "trigger_delay_us = 6000")
    assert parse_rig(slow.replace("exposure_ms = 12.0", "exposure_ms = 10.66")).camera.left.exposure_ms == 10.66
    for side, text in (("left", slow.replace("exposure_ms = 12.0", "exposure_ms = 10.67", 1)), ("right", slow)):
        with pytest.raises(ConfigError) as caught:
            parse_rig(text if side == "left" else slow.replace("exposure_ms = 12.0", "exposure_ms = 10.0", 1))
        assert f"camera.{side}.exposure_ms" in caught.value.headline
        assert "> 10.66" in caught.value.headline
        assert "0.05..10.66 ms (period 16.67 ms less trigger delay 6 ms)" in str(caught.value)


def test_the_only_exposures_are_a_list_within_the_range_that_has_the_rigs_own() -> None:
    def with_list(text: str) -> str:
        return PACKAGED.replace("[water]", f"exposures_ms = {text}\n\n[water]", 1)

    assert RIG.scan.exposures_ms is None
    assert parse_rig(with_list("[5.0, 12, 16.6]")).scan.exposures_ms == (5.0, 12.0, 16.6)
    assert len(parse_rig(with_list(str([12.0] * 32))).scan.exposures_ms or ()) == 32
    for text in ("[]", "[0.04, 12.0]", "[12.0, 16.7]", '["12"]', "12.0", str([12.0] * 33)):
        with pytest.raises(ConfigError, match="exposures_ms"):
            parse_rig(with_list(text))
    with pytest.raises(ConfigError, match=r"camera\.left\.exposure_ms 12 .*allowed: 5, 16"):
        parse_rig(with_list("[5.0, 16.0]"))
    only = replace(RIG, scan=replace(RIG.scan, exposures_ms=(8.0, 12.0), most_gain_db=2.0))
    proposed = [(one.time_us, one.gain_db) for one in Instrument(only).exposures]
    assert proposed == [(8000, 0.0), (8000, 2.0), (12000, 0.0), (12000, 2.0)]
    assert Instrument(RIG).exposures[0].time_us == 2000


def test_outputs_share_a_connector_only_where_they_are_two() -> None:
    same = PACKAGED.replace('"DP-1"', '"HDMI-A-1"')
    for other in (
        same.replace('card = "/dev/dri/card0"', 'card = "/dev/dri/card1"', 1),
        same.replace('kind = "kms" ', 'kind = "window" ', 1),
        same.replace('[display]\nkind = "kms"', '[display]\nkind = "window"', 1),
    ):
        assert parse_rig(other).projector.connector == parse_rig(other).display.connector
    with pytest.raises(ConfigError, match=r"display\.connector .* same as projector\.connector"):
        parse_rig(same)


@pytest.mark.parametrize("key", ["card", "connector"])
@pytest.mark.parametrize("output", ["projector", "display"])
def test_an_output_of_a_graphics_card_names_card_and_connector_and_a_window_does_not(output: str, key: str) -> None:
    head, _, rest = PACKAGED.partition(f"[{output}]")
    line = next(line for line in rest.splitlines(keepends=True) if line.startswith(key))
    without = f"{head}[{output}]" + rest.replace(line, "", 1)
    with pytest.raises(ConfigError, match=rf"{output}\.{key} missing"):
        parse_rig(without)
    window = parse_rig(without.replace(f'[{output}]\nkind = "kms"', f'[{output}]\nkind = "window"'))
    assert getattr(getattr(window, output), key) is None


def pattern_mode(delay_us: int = 500, left_ms: float = 11.11, right_ms: float = 11.11, more: str = "") -> str:
    """Return a rig file of a projector with three sub-frames of 5.556 ms."""
    text = PACKAGED.replace("trigger_delay_us = 500", f"trigger_delay_us = {delay_us}")
    for exposure_ms in (left_ms, right_ms):
        text = text.replace("exposure_ms = 12.0", f"exposure_ms = {exposure_ms}", 1)
    text = text.replace("[display]", "sub_frames = 3\nlight_begins_us = 500\n\n[display]", 1)
    return text.replace("[water]", f"{more}\n\n[water]", 1)


def test_what_a_projector_of_sub_frames_is_exposed_for_are_whole_ones() -> None:
    rig = parse_rig(pattern_mode())
    assert [one.time_us for one in Instrument(rig).exposures if one.gain_db == 0.0] == [5556, 11111]
    assert Instrument(parse_rig(pattern_mode(more="exposures_ms = [11.11]"))).exposures[0].time_us == 11110
    for left_ms in (11.1, 11.13, 5.56):
        assert parse_rig(pattern_mode(left_ms=left_ms, right_ms=left_ms)).camera.left.exposure_ms == left_ms
    for left_ms in (11.0, 11.09, 11.14, 0.06):
        with pytest.raises(ConfigError, match=rf"exposure_ms {left_ms:g} .*allowed: 5\.556, 11\.111, 16\.667"):
            parse_rig(pattern_mode(left_ms=left_ms, right_ms=left_ms))
    with pytest.raises(ConfigError, match=r"scan\.exposures_ms 8 is no multiple"):
        parse_rig(pattern_mode(more="exposures_ms = [8.0, 11.11]"))
    with pytest.raises(ConfigError, match=r"camera\.right\.exposure_ms 5\.56 .*allowed: 11\.11"):
        parse_rig(pattern_mode(right_ms=5.56))


def test_a_trigger_begins_with_a_sub_frame() -> None:
    for delay_us in (400, 600, 6056):
        assert parse_rig(pattern_mode(delay_us, 5.56, 5.56)).board.trigger_delay_us == delay_us
    for delay_us in (399, 601, 6157):
        with pytest.raises(ConfigError, match=rf"trigger_delay_us {delay_us} .*allowed: 500, 6056, 11611 us"):
            parse_rig(pattern_mode(delay_us, 5.56, 5.56))


def test_an_exposure_may_last_as_much_longer_as_its_light_begins_later() -> None:
    late = PACKAGED.replace("trigger_delay_us = 500", "trigger_delay_us = 6000")
    with pytest.raises(ConfigError, match=r"> 10\.66"):
        parse_rig(late)
    rig = parse_rig(late.replace("[display]", "light_begins_us = 6000\n\n[display]", 1))
    assert Instrument(rig).exposures[-1].time_us == 16_000
    # A trigger before the light begins gains nothing: what was shown before is seen first.
    early = PACKAGED.replace("trigger_delay_us = 500", "trigger_delay_us = 3000")
    begins = parse_rig(early.replace("[display]", "light_begins_us = 6000\n\n[display]", 1))
    assert Instrument(begins).exposures == Instrument(parse_rig(early)).exposures
    assert Instrument(begins).exposures[-1].time_us == 12_000


def test_an_exposure_of_before_that_is_not_allowed_any_more_becomes_the_nearest() -> None:
    rig = parse_rig(pattern_mode())
    before = replace(standard_choices(rig), exposure=Exposure(10_000))
    assert machine_settings(rig, before).choices.exposure == Exposure(11_110)
    assert machine_settings(RIG, before).choices.exposure == Exposure(10_000)
    allowed = replace(before, exposure=Exposure(5_556, 2.0))
    assert machine_settings(rig, allowed).choices.exposure == Exposure(5_556, 2.0)


def test_the_machine_counts_the_frames_of_the_projector_that_is_fitted() -> None:
    """Times and timeouts of a capture follow from the count, and so does what a screen says of it."""
    compact = replace(RIG, projector=replace(RIG.projector, width_px=1280, height_px=720))
    assert machine_settings(RIG).frames == {16: 24, 32: 22, 64: 20}
    settings = machine_settings(compact)
    assert settings.frames == {16: 25, 32: 23, 64: 21}
    assert settings.light_s(16) == pytest.approx(25 / 60)
