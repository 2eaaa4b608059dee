"""Triggers on cameras in the manner of three makers: what costs frames, what shifts or stretches exposures."""

from __future__ import annotations

from typing import Any

import pytest
from genicam.genapi import AccessException

from tests.hw_sim.conftest import HandTime
from tests.hw_sim.devices.bus import SIRM, Bus, careful

PERSONALITIES = ("blackfly", "ace", "alvium")
PULSES = 12


def taken(bus: Bus, width_ms: float = 8.0) -> int:
    """Frames that come of 12 pulses at 60 Hz."""
    bus.start()
    bus.pulses(PULSES, width_ms=width_ms)
    return len(bus.frames())


@pytest.mark.parametrize("personality", PERSONALITIES)
def test_a_camera_set_up_with_care_gives_a_frame_for_each_pulse(hand_time: HandTime, personality: str) -> None:
    bus = Bus(hand_time, personality)
    careful(bus, personality)
    bus.set(ExposureTime=12_000.0)
    assert taken(bus) == PULSES


@pytest.mark.parametrize(
    ("personality", "wrong", "frames"),
    [
        ("blackfly", {"TriggerOverlap": "Off"}, PULSES // 2),
        ("ace", {"OverlapMode": "Off"}, PULSES // 2),
        ("alvium", {"AcquisitionFrameRate": 40.0, "AcquisitionFrameRateEnable": True}, PULSES // 2),
        ("alvium", {"DeviceLinkThroughputLimit": 1_000_000}, PULSES // 2),
        ("blackfly", {"DeviceLinkThroughputLimit": 1_000_000}, PULSES // 2),
        ("ace", {"DeviceLinkThroughputLimit": 1_000_000, "DeviceLinkThroughputLimitMode": "On"}, PULSES // 2),
        ("ace", {"DeviceLinkThroughputLimit": 1_000_000, "DeviceLinkThroughputLimitMode": "Off"}, PULSES),
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
    bus = Bus(hand_time, personality)
    careful(bus, personality)
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
    bus = Bus(hand_time, "blackfly")
    careful(bus, "blackfly")
    bus.set(**wrong)
    bus.start()
    pulse_ns = hand_time.now_ns()
    bus.pulses(1, width_ms=5.0)
    (exposure,) = bus.exposures
    assert (exposure.start_ns - pulse_ns) / 1e6 == pytest.approx(start_ms)
    assert exposure.duration_ns / 1e6 == pytest.approx(duration_ms)


def test_gain_that_the_camera_chooses_is_not_the_hosts(hand_time: HandTime) -> None:
    bus = Bus(hand_time, "blackfly")
    careful(bus, "blackfly")
    bus.set(Gain=3.0)
    bus.set(GainAuto="Continuous")
    assert taken(bus)
    assert bus.exposures[0].gain_db == 12.0
    with pytest.raises(AccessException):
        bus.set(Gain=6.0)
    assert bus.get("Gain") == 3.0


@pytest.mark.parametrize(("personality", "acts"), [("ace", False), ("blackfly", True)])
def test_an_exposure_mode_written_before_its_trigger_does_not_act_on_an_ace(
    hand_time: HandTime, personality: str, acts: bool
) -> None:
    bus = Bus(hand_time, personality)
    careful(bus, personality)
    bus.set(TriggerMode="Off")
    bus.set(ExposureMode="TriggerWidth")
    bus.set(TriggerMode="On")
    assert bus.get("ExposureMode") == "TriggerWidth", "it reads back as if all were well"
    assert taken(bus, width_ms=3.0)
    assert (bus.exposures[0].duration_ns < 4_000_000) is acts
    bus.stop()
    bus.set(ExposureMode="TriggerWidth")
    taken(bus, width_ms=3.0)
    assert bus.exposures[-1].duration_ns < 4_000_000


def test_an_ace_waits_with_the_next_pulse_until_its_readout_is_over_unless_told(hand_time: HandTime) -> None:
    bus = Bus(hand_time, "ace")
    careful(bus, "ace")
    bus.set(ExposureMode="TriggerWidth", ExposureOverlapTimeMax=0.0)
    assert taken(bus, width_ms=12.0) == PULSES // 2
    bus.stop()
    bus.set(ExposureOverlapTimeMax=12_000.0)
    assert taken(bus, width_ms=12.0) == PULSES


def test_a_host_that_sets_the_trigger_it_finds_selected_turns_on_another_one(hand_time: HandTime) -> None:
    """An Alvium's selector stands on AcquisitionStart: after the first pulse it runs freely, whatever the line does."""
    bus = Bus(hand_time, "alvium")
    bus.set(TriggerSource="Line0", TriggerMode="On", ExposureTime=8000.0)
    bus.start()
    bus.pulses(2)
    assert len(bus.frames()) > 10, "in a third of a second"


def test_software_triggers_are_for_the_trigger_that_is_selected(hand_time: HandTime) -> None:
    bus = Bus(hand_time, "alvium")
    careful(bus, "alvium")
    bus.set(TriggerSelector="AcquisitionStart", TriggerSource="Software", TriggerMode="On")
    bus.start()
    bus.pulses(3)
    assert bus.frames() == []
    bus.press("TriggerSoftware")
    bus.pulses(3)
    assert len(bus.frames()) == 3


def test_both_edges_of_a_pulse_are_two_triggers(hand_time: HandTime) -> None:
    bus = Bus(hand_time, "blackfly")
    careful(bus, "blackfly")
    bus.set(TriggerActivation="AnyEdge", ExposureTime=1000.0)
    bus.start()
    bus.pulses(3, period_ms=100.0, width_ms=20.0)
    assert len(bus.frames()) == 6


def test_a_small_memory_loses_what_the_host_does_not_read_and_says_so(hand_time: HandTime) -> None:
    bus = Bus(hand_time, "ace", memory_blocks=2)
    careful(bus, "ace")
    assert taken(bus) == 3
    room = [bus.camera.room]
    bus.pulses(5)
    room.append(bus.camera.room)
    assert room == [True, False], "a world in lock step waits here for its host"
    frames = bus.frames()
    assert [f.status for f in frames] == [0, 0, 0xA101], "DATA_OVERRUN"
    assert frames[-1].valid == 0
    assert bus.u32(SIRM + 4) == 1
