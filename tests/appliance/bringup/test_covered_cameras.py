"""What covered cameras and their settings are told to be, from grey values and read-backs alone."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.bringup.camera_check import judge_dark, judge_link, judge_settings, see_dark
from appliance.bringup.finding import Finding
from drivers.api import HeldSetting

READ_DN = 0.5


def dark(
    black_dn: float = 2.0,
    noise_dn: float = 0.5,
    *,
    ambient_dn: float = 0.0,
    hot: int = 0,
    leak_dn: float = 0.0,
    frozen: bool = False,
) -> dict[str, Finding]:
    """What is said of a camera of 100 x 80 px: ``ambient_dn`` more in the longer exposure, ``leak_dn`` in a corner of it."""
    rng = np.random.default_rng(5)

    def taken(light_dn: float) -> NDArray[np.uint8]:
        frames = black_dn + light_dn * ambient_dn + noise_dn * rng.standard_normal((16, 80, 100))
        frames[:, :20, :25] += light_dn * leak_dn
        if hot:
            frames.reshape(16, -1)[:, 3 : 3 + hot] += 60.0
        if frozen:
            frames[:] = frames[0]
        return np.clip(np.rint(frames), 0, 255).astype(np.uint8)

    short, long = taken(0.0), taken(1.0)
    findings = judge_dark("left", see_dark(long, short), 2.0, READ_DN)
    return {one.name.removeprefix("camera.left "): one for one in findings}


def test_a_covered_camera_of_the_data_sheet_is_good() -> None:
    found = dark()
    assert all(one.ok for one in found.values()), found
    assert found["black"].numbers["level_dn"] == pytest.approx(2.0, abs=0.2)


@pytest.mark.parametrize(
    ("seen", "name", "remedy"),
    [
        (dark(black_dn=9.0), "black", "set BlackLevel"),
        (dark(black_dn=0.2), "black", "raise BlackLevel"),
        (dark(noise_dn=3.0), "noise", "gamma"),
        (dark(black_dn=2.0, noise_dn=0.0), "noise", "test pattern"),
        (dark(frozen=True), "noise", "test pattern"),
        (dark(ambient_dn=6.0), "light", "put the cap on"),
        (dark(leak_dn=4.0), "light", "look for light"),
        (dark(hot=40), "hot pixels", "defect correction"),
    ],
)
def test_what_is_wrong_in_the_dark_is_told_by_its_own_finding(seen: dict[str, Finding], name: str, remedy: str) -> None:
    assert not seen[name].ok
    assert remedy in seen[name].remedy


@pytest.mark.parametrize("count", [2, 3, 8])
def test_the_noise_of_few_frames_is_that_of_many(count: int) -> None:
    """Divided by n in place of n - 1, two frames would show 71 % of it."""
    grey = np.rint(20.0 + 4.0 * np.random.default_rng(7).standard_normal((count, 200, 200))).astype(np.uint8)
    assert see_dark(grey, grey).noise_dn == pytest.approx(np.hypot(4.0, 1.0 / np.sqrt(12.0)), rel=0.02)


def test_a_high_black_level_is_no_light_and_light_is_no_level_alone() -> None:
    assert dark(black_dn=9.0)["light"].ok
    assert not dark(ambient_dn=6.0)["light"].ok


HELD = (
    HeldSetting("TriggerMode", "On", "On"),
    HeldSetting("ExposureTime", None, 12_000.0),
    HeldSetting("Gamma", None, None),
)


def test_settings_that_read_back_as_they_were_set_are_good_and_what_is_missing_is_said() -> None:
    settings, tone = judge_settings("left", HELD)
    assert settings.ok
    assert tone.ok
    assert "all 1 settings" in settings.said
    assert "not offered: Gamma" in settings.said


def test_a_setting_that_fell_back_is_named_with_both_values() -> None:
    settings, _ = judge_settings("left", (*HELD, HeldSetting("TriggerOverlap", "ReadOut", "Off")))
    assert not settings.ok
    assert "TriggerOverlap is Off, not ReadOut" in settings.said


@pytest.mark.parametrize(
    ("one", "bent"),
    [
        (HeldSetting("GammaEnable", True, True), True),
        (HeldSetting("LUTEnable", True, True), True),
        (HeldSetting("Gamma", 0.7, 0.7), True),
        (HeldSetting("Gamma", 1.0, 1.0), False),
        (HeldSetting("GammaEnable", False, False), False),
    ],
)
def test_a_gamma_or_a_table_that_is_on_is_named_even_where_it_was_asked_for(one: HeldSetting, bent: bool) -> None:
    _, tone = judge_settings("right", (*HELD[:2], one))
    assert tone.ok is not bent
    assert not bent or one.feature in tone.said


def test_a_gamma_that_is_switched_off_may_have_any_number() -> None:
    _, tone = judge_settings("left", (HeldSetting("GammaEnable", False, False), HeldSetting("Gamma", None, 0.45)))
    assert tone.ok


def test_a_slow_link_is_told_with_its_remedy() -> None:
    found = judge_link("left", 480, "the link runs at 480 Mbit/s; SuperSpeed (5000) is needed")
    assert not found.ok
    assert "480" in found.said
    assert "port of its own" in found.remedy
    assert judge_link("left", 5000, None).ok
    assert judge_link("left", None, None).ok
