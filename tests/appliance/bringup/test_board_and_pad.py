"""What boards, pads and vertical syncs that are wrong are told to be, from values alone."""

from __future__ import annotations

import pytest

from appliance.bringup.board_check import judge_beats, judge_clock, judge_laser, judge_sensor
from appliance.bringup.endurance_check import Endured, SideEndured, judge_endurance
from appliance.bringup.finding import Finding
from appliance.bringup.pad_check import KeyTried, PadHeard, judge_key, judge_pad
from appliance.bringup.stamps_check import judge_stamps
from appliance.bringup.vsync_check import VsyncSeen, judge_stamps_of_syncs, judge_vsync
from appliance.service.bringup.endurance import _Fired
from drivers.api import BoardTime, LaserState, Pulse, PulsesDone

OFF, LEFT, RIGHT, BOTH = (LaserState(*on) for on in ((False, False), (True, False), (False, True), (True, True)))


def named(findings: tuple[Finding, ...]) -> dict[str, Finding]:
    return {one.name: one for one in findings}


def expect_wrong(finding: Finding, said: str, remedy: str) -> None:
    """It is wrong, and says what and what to do."""
    assert not finding.ok
    assert said in finding.said
    assert remedy in finding.remedy


# ------------------------------------------------------------------------------------------ board


def test_heartbeats_every_half_second_are_good() -> None:
    found = judge_beats([0, 500_010, 1_000_020, 1_500_010], 0, 0)
    assert found.ok
    assert found.numbers["longest_ms"] == pytest.approx(500.01)


def test_a_missing_heartbeat_a_lost_report_and_silence_are_told() -> None:
    expect_wrong(judge_beats([0, 500_000, 1_500_000], 0, 0), "1000 ms apart", "USB port")
    expect_wrong(judge_beats([0, 500_000, 1_000_000], 1, 0), "1 reports lost", "USB port")
    expect_wrong(judge_beats([0, 500_000, 1_000_000], 0, 2), "2 lines damaged", "supply")
    expect_wrong(judge_beats([0], 0, 0), "1 heartbeats", "flash")


def clock(ppm: float, bracket_us: float = 100.0) -> list[BoardTime]:
    """Readings each half second for 20 s; the board reads at the beginning of the bracket first, at its end last."""
    found = []
    for k in range(41):
        sent_ns = round(k * 0.5e9)
        inside_ns = 0.0 if k < 20 else 1000.0 * bracket_us
        found.append(
            BoardTime(
                round((sent_ns + inside_ns) * (1 + ppm * 1e-6) / 1000.0), sent_ns, round(sent_ns + 1000 * bracket_us)
            )
        )
    return found


def test_a_clocks_drift_is_measured_within_what_its_brackets_leave_open() -> None:
    found = judge_clock(clock(30.0))
    drift_ppm, unsure_ppm = found.numbers["drift_ppm"], found.numbers["uncertainty_ppm"]
    assert found.ok
    assert drift_ppm is not None
    assert unsure_ppm is not None
    assert abs(drift_ppm - 30.0) <= unsure_ppm < 12.0


def test_a_clock_of_an_oscillator_without_crystal_is_told_and_no_wide_bracket_is_mistaken_for_it() -> None:
    expect_wrong(judge_clock(clock(400.0)), "ppm against the host", "crystal")
    assert judge_clock(clock(30.0, bracket_us=20_000.0)).ok
    assert not judge_clock([]).ok


def test_a_laser_is_off_on_off_by_itself() -> None:
    assert judge_laser("left", (OFF, LEFT, OFF)).ok
    expect_wrong(judge_laser("left", (OFF, OFF, OFF)), "off, off, off", "shunt amplifier")
    expect_wrong(judge_laser("left", (OFF, LEFT, LEFT)), "off, on, on", "conducts while it is off")
    expect_wrong(judge_laser("right", (OFF, LEFT, OFF)), "the left one answered instead", "exchange")
    expect_wrong(judge_laser("right", (OFF, BOTH, OFF)), "the left one came on as well", "bridge")


def test_each_sensor_is_named_with_its_range() -> None:
    assert judge_sensor("TCASE", True, 21.5).ok
    assert judge_sensor("HUM", False, None).ok, "what is not fitted is no fault"
    expect_wrong(judge_sensor("HUM", True, None), "does not answer", "wires")
    expect_wrong(judge_sensor("TPROJ", True, -127.0), "-127 °C is not plausible", "type")
    expect_wrong(judge_sensor("LEAK", True, 1.0), "1 (0 dry, 1 wet)", "dry the electrodes")
    expect_wrong(judge_sensor("SUPPLY", True, 10.0, supply_low_v=10.8), "10 V", "divider")


# ------------------------------------------------------------------------------------------ pad


@pytest.mark.parametrize(
    ("tried", "said", "remedy"),
    [
        (KeyTried("up", (), ()), "was not pressed", "threshold"),
        (KeyTried("up", ("down",), ("down",)), "down answered instead", "exchange the coils' wires"),
        (KeyTried("up", ("up", "down"), ("up", "down"), 0.2), "down answered as well", "coils see each other"),
        (KeyTried("up", ("up",), ()), "stays pressed", "does not come back"),
        (KeyTried("up", ("up", "up"), ("up", "up"), 0.1), "answered 2 times", "hysteresis"),
    ],
)
def test_a_key_that_is_wrong_is_told_from_the_others(tried: KeyTried, said: str, remedy: str) -> None:
    expect_wrong(judge_key(tried), said, remedy)


def test_coils_and_reports_are_judged_by_themselves() -> None:
    good = KeyTried("scan", ("scan",), ("scan",), 0.15)
    found = named(judge_pad(PadHeard((good,), frozenset({"back"}), 3, 0, 0)))
    assert found["key.scan"].ok
    expect_wrong(found["coils"], "back", "shorted")
    expect_wrong(found["reports"], "3 reports lost", "USB cable")
    assert all(one.ok for one in judge_pad(PadHeard((good,), frozenset(), 0, 0, 0)))


# ------------------------------------------------------------------------------------------ vertical sync


def syncs(hz: float = 60.0, late_us: float = 0.0, count: int = 100) -> tuple[tuple[int, int], ...]:
    return tuple((7 + k, round(k * 1e6 / hz + (late_us if k == 40 else 0.0))) for k in range(count))


@pytest.mark.parametrize(
    ("hz", "remedy"),
    [(59.8, "refresh_hz"), (120.0, "both edges"), (30.0, "divider"), (75.0, "choose a mode of 60 Hz")],
)
def test_a_rate_that_is_not_the_rig_files_is_told(hz: float, remedy: str) -> None:
    rate, jitter = judge_stamps_of_syncs(syncs(hz), 60.0)
    expect_wrong(rate, f"{hz:.3f} Hz", remedy)
    assert jitter.ok


def test_a_rate_within_a_tenth_is_good_and_one_late_stamp_is_jitter() -> None:
    rate, jitter = judge_stamps_of_syncs(syncs(59.95), 60.0)
    assert rate.ok
    assert jitter.ok
    rate, jitter = judge_stamps_of_syncs(syncs(late_us=9.0), 60.0)
    assert rate.ok
    expect_wrong(jitter, "away from an even beat", "stamp syncs in hardware")


def test_no_syncs_at_all_lead_to_the_tap() -> None:
    for one in judge_stamps_of_syncs((), 60.0):
        expect_wrong(one, "0 syncs", "tap")


def vsync(syncs_seen: int = 600, stopped_after_ms: float | None = 20.0) -> dict[str, Finding]:
    return named(judge_vsync(VsyncSeen(60.0, syncs(), 600, syncs_seen, 12.0, stopped_after_ms)))


def test_syncs_are_as_many_as_blanks_and_end_with_the_picture() -> None:
    assert all(one.ok for one in vsync().values())
    expect_wrong(vsync(601)["count"], "601 syncs in 600 blanks", "noise is counted")
    expect_wrong(vsync(598)["count"], "598 syncs in 600 blanks", "missed")
    expect_wrong(vsync(stopped_after_ms=None)["stop"], "go on", "splitter")


def test_the_edge_is_said_to_be_unknown() -> None:
    assert "cannot be told" in vsync()["edge"].said


# ------------------------------------------------------------------------------------------ stamps


def stamps(late_ns: int = 0, ppm: float = 0.0, at: int = 30) -> Finding:
    pulses = [1_000_000 + round(k * 16_666.7) for k in range(64)]
    frames: list[int | None] = [
        round((p - pulses[0]) * 1000 * (1 + ppm * 1e-6)) + 77_000_000 + (late_ns if k == at else 0)
        for k, p in enumerate(pulses)
    ]
    return judge_stamps(pulses, {"left": frames})[0]


def test_a_constant_offset_and_two_crystals_drift_are_good() -> None:
    found = stamps(ppm=80.0)
    assert found.ok
    assert found.numbers["drift_ppm"] == pytest.approx(80.0, abs=1.0)


def test_jitter_and_a_clock_of_another_unit_are_told() -> None:
    found = stamps(late_ns=60_000)
    expect_wrong(found, "exposures follow pulses to", "opto-coupler")
    assert "frame 30 is the worst" in found.remedy
    assert found.numbers["jitter_rms_us"] == pytest.approx(60.0 / 8.0, rel=0.03), "one of 64"
    expect_wrong(stamps(ppm=20_000.0), "ppm apart", "unit of the camera's time stamps")


def test_a_camera_without_a_clock_is_no_fault_but_lists_of_other_lengths_are() -> None:
    assert judge_stamps([0, 1], {"left": [None, None]})[0].ok
    expect_wrong(judge_stamps(list(range(64)), {"left": list(range(63))})[0], "cannot be compared", "first see")


# ------------------------------------------------------------------------------------------ endurance


def test_each_reported_pulse_is_counted_until_the_board_is_done() -> None:
    fired = _Fired()
    assert not any(fired.take(Pulse(k, k, 16_667 * k)) for k in range(3))
    assert fired.take(PulsesDone(3))
    assert (fired.reported, fired.ended_by) == (3, None)


WHOLE = SideEndured(6400, (), 0, 0)


def endured(
    left: SideEndured = WHOLE, reported: int = 6400, after_c: float = 40.0, ended: str | None = None
) -> dict[str, Finding]:
    seen = Endured(
        1.8,
        1.8,
        6400,
        reported,
        0,
        {"left": left, "right": WHOLE},
        {"case": 21.0},
        {"case": after_c, "projector": None},
        ended,
    )
    return named(judge_endurance(seen, {"case": 50.0, "projector": 65.0}))


def test_every_pulse_a_whole_stamped_frame_is_good() -> None:
    found = endured()
    assert all(one.ok for one in found.values())
    assert "from 21.0 °C" in found["warmth.case"].said
    assert "no thermometer" in found["warmth.projector"].said


@pytest.mark.parametrize(
    ("left", "said", "remedy"),
    [
        (SideEndured(6399, ("discarded",), 0, 0), "1 arrived discarded (1x)", "usbfs_memory_mb"),
        (SideEndured(6398, (), 0, 2), "with 2 gaps", "another cable"),
        (SideEndured(6400, (), 0, 1), "with 1 gaps", "another cable"),
        (SideEndured(6399, (), 0, 0), "6399 whole frames of 6400", "lost between"),
        (SideEndured(6400, (), 3, 0), "3 without a time", "firmware"),
        (SideEndured(70, (), 0, 0, "unplugged"), "the camera was lost: unplugged", "dmesg"),
    ],
)
def test_what_minutes_bring_out_is_told_by_camera(left: SideEndured, said: str, remedy: str) -> None:
    found = endured(left)
    expect_wrong(found["camera.left"], said, remedy)
    assert found["camera.right"].ok


def test_a_lost_stamp_heat_and_an_early_end_are_told() -> None:
    expect_wrong(endured(reported=6399)["pulses"], "6399 of 6400", "USB port")
    expect_wrong(endured(after_c=55.0)["warmth.case"], "55.0 °C", "heat")
    expect_wrong(endured(ended="the board restarted (BROWNOUT)")["run"], "BROWNOUT", "findings below")
