"""Triggers on cameras in the manner of three makers: what costs frames, what shifts or stretches exposures."""

from __future__ import annotations

from typing import Any

import pytest

from tests.hw_sim.conftest import HandTime
from tests.hw_sim.devices.bus import Bus, careful

PULSES = 12
SLOW_LINK = {"DeviceLinkThroughputLimit": 1_000_000}


def taken(bus: Bus, width_ms: float = 8.0) -> int:
    """Frames that come of 12 pulses at 60 Hz."""
    bus.start()
    bus.pulses(PULSES, width_ms=width_ms)
    return len(bus.frames())


@pytest.mark.parametrize(
    ("personality", "wrong", "frames"),
    [
        ("blackfly", {}, PULSES),
        ("ace", {}, PULSES),
        ("alvium", {}, PULSES),
        ("blackfly", {"TriggerOverlap": "Off"}, PULSES // 2),
        ("ace", {"OverlapMode": "Off"}, PULSES // 2),
        ("alvium", {"AcquisitionFrameRate": 40.0, "AcquisitionFrameRateEnable": True}, PULSES // 2),
        ("alvium", SLOW_LINK, PULSES // 2),
        ("blackfly", SLOW_LINK, PULSES // 2),
        ("ace", {**SLOW_LINK, "DeviceLinkThroughputLimitMode": "On"}, PULSES // 2),
        ("ace", {**SLOW_LINK, "DeviceLinkThroughputLimitMode": "Off"}, PULSES),
        ("blackfly", {"TriggerSource": "Line3"}, 0),
        ("ace", {"TriggerSource": "Software"}, 0),
        ("alvium", {"LineSelector": "Line0", "LineMode": "Output"}, 0),
        ("alvium", {"TriggerSelector": "ExposureActive", "TriggerMode": "On", "TriggerSource": "Line0"}, 0),
        ("alvium", {"TriggerSelector": "AcquisitionStart", "TriggerMode": "On", "TriggerSource": "Software"}, 0),
        ("alvium", {"TriggerSelector": "AcquisitionStart", "TriggerMode": "On", "TriggerSource": "Line0"}, PULSES - 1),
        ("ace", {"TriggerSelector": "FrameBurstStart", "TriggerMode": "On", "TriggerSource": "Line1"}, PULSES // 2),
    ],
)
def test_each_wrong_value_alone_costs_its_frames(
    hand_time: HandTime, personality: str, wrong: dict[str, Any], frames: int
) -> None:
    bus = careful(hand_time, personality)
    bus.set(ExposureTime=12_000.0, **wrong)
    assert taken(bus) == frames


@pytest.mark.parametrize(
    ("wrong", "start_ms", "duration_ms"),
    [
        ({}, 0.0, 8.0),
        ({"TriggerActivation": "FallingEdge"}, 5.0, 8.0),
        ({"LineSelector": "Line0", "LineInverter": True}, 5.0, 8.0),
        ({"TriggerDelay": 1500.0}, 1.5, 8.0),
        ({"ExposureAuto": "Continuous"}, 0.0, 14.0),
        ({"ExposureMode": "TriggerWidth"}, 0.0, 5.014),
    ],
)
def test_each_wrong_value_alone_shifts_or_stretches_the_exposure(
    hand_time: HandTime, wrong: dict[str, Any], start_ms: float, duration_ms: float
) -> None:
    bus = careful(hand_time, "blackfly")
    bus.set(**wrong, GainAuto="Continuous")
    bus.start()
    pulse_ns = hand_time.now_ns()
    bus.pulses(1, width_ms=5.0)
    (exposure,) = bus.exposures
    assert (exposure.start_ns - pulse_ns) / 1e6 == pytest.approx(start_ms)
    assert exposure.duration_ns / 1e6 == pytest.approx(duration_ms)
    assert exposure.gain_db == 12.0, "chosen by the camera"


@pytest.mark.parametrize(("personality", "acts"), [("ace", False), ("blackfly", True)])
def test_an_exposure_mode_written_before_its_trigger_does_not_act_on_an_ace(
    hand_time: HandTime, personality: str, acts: bool
) -> None:
    bus = careful(hand_time, personality)
    for name, value in (("TriggerMode", "Off"), ("ExposureMode", "TriggerWidth"), ("TriggerMode", "On")):
        bus.set(**{name: value})
    assert bus.get("ExposureMode") == "TriggerWidth", "it reads back as if all were well"
    assert taken(bus, width_ms=3.0)
    assert (bus.exposures[0].duration_ns < 4_000_000) is acts
    bus.stop()
    bus.set(ExposureMode="TriggerWidth")
    taken(bus, width_ms=3.0)
    assert bus.exposures[-1].duration_ns < 4_000_000


def test_a_host_that_sets_the_trigger_it_finds_selected_turns_on_another_one(hand_time: HandTime) -> None:
    """An Alvium's selector stands on AcquisitionStart: after the first pulse it runs freely, whatever the line does."""
    bus = Bus(hand_time, "alvium")
    bus.set(TriggerSource="Line0", TriggerMode="On", ExposureTime=8000.0)
    bus.start()
    bus.pulses(2)
    assert len(bus.frames()) > 10, "in a third of a second"
