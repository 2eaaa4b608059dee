"""What is made of frames: of triggers, of covered cameras, of minutes at full rate, of a plane and of a projector, from values alone."""

from __future__ import annotations

import datetime
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import appliance
from appliance.instrument.capture.grabber import SideRecording
from appliance.instrument.capture.ledger import Ledger
from appliance.instrument.capture.scan import CaptureReport
from appliance.measure.light.exposure import Exposure
from appliance.measure.light.patterns import build_sequence
from appliance.store.config import load_rig, rig_text
from appliance.store.instrument import Instrument
from appliance.store.library import Library
from appliance.store.scan import StoredScan
from appliance.workshop import cameras, endurance, plane, projector
from appliance.workshop.endurance import CameraEndurance
from appliance.workshop.finding import BringupError
from appliance.workshop.step import wall
from appliance.workshop.trigger import trigger_findings
from drivers import api
from tests.appliance.workshop.scripted import PERIOD_NS, RIG_FILE, BenchBoard, ValueBench, workplace
from tests.drivers.clock import SteppedClock

RIG = load_rig(RIG_FILE)
BLACK_DN = RIG.camera.left.black_level_dn


def frame(k: int, status: api.FrameStatus = api.FrameStatus.COMPLETE, **more: Any) -> api.Frame:
    made: dict[str, Any] = {"block_id": k, "camera_time_ns": round(k * PERIOD_NS) + 77, "received_ns": 0, **more}
    return api.Frame(status, **made)


def ledger(left: list[api.Frame], pulses: int = 64) -> Ledger:
    reported = tuple(api.Pulse(k, k, round(k * PERIOD_NS / 1000.0)) for k in range(pulses))
    right = tuple(frame(k) for k in range(64))
    return Ledger(64, PERIOD_NS, None, None, 500, (), reported, {"left": tuple(left), "right": right}, None)


def told(left: list[api.Frame], pulses: int = 64) -> dict[str, bool]:
    return {one.name: one.ok for one in trigger_findings(ledger(left, pulses))}


def test_frames_are_counted_first_and_their_stamps_compared_only_of_as_many() -> None:
    whole = [frame(k) for k in range(64)]
    everything = dict.fromkeys(("pulses", "camera.left", "camera.right", "stamps.left", "stamps.right"), True)
    assert told(whole) == everything
    late = [*whole[:30], frame(30, camera_time_ns=round(30 * PERIOD_NS) + 60_000), *whole[31:]]
    assert told(late) == everything | {"stamps.left": False}
    short = told(whole[:63])
    assert not short["camera.left"]
    assert "stamps.left" not in short
    assert short["stamps.right"]
    missing = told(whole, 63)
    assert not missing["pulses"]
    assert "stamps.right" not in missing, "as many frames as there are pulses, or nothing"


def dark(light_dn: float = 0.0, until_take: int = 10**9) -> ValueBench:
    """Cameras whose longer exposures are brighter by ``light_dn`` in the first takes; only the last 16 frames are calm."""
    rng = np.random.default_rng(1)
    frames = BLACK_DN + Instrument(RIG).noise().left.read_dn * rng.standard_normal((64, 16, 24))
    frames[:48] += 100.0
    short, long = (np.clip(np.rint(one), 0, 255).astype(np.uint8) for one in (frames, frames + light_dn))
    return ValueBench(lambda _side, shot, take: long if shot.exposure_us > 500 and take <= until_take else short)


def test_light_is_waited_out_for_a_minute_and_asked_about_three_times() -> None:
    at, person, told_ = workplace()
    bench: Any = dark(40.0)
    bench.clock, bench.take_s = at.wires.clock, 10.0
    begun_ns = at.wires.clock.now_ns()
    found, _ = cameras._dark(at, bench)
    assert {one.name for one in found if not one.ok} >= {"camera.left light", "camera.right light"}
    assert len(person.said) == 3
    # Takes of 10 s and a pause of half a second: after 41 s it is looked at once more, after 61 s no more.
    assert len(told_.all) == 3 * 3
    assert (at.wires.clock.now_ns() - begun_ns) / 1e9 == pytest.approx(3 * 61.0)
    at, person, _ = workplace()
    found, _ = cameras._dark(at, dark(40.0, until_take=6))  # type: ignore[arg-type]
    assert all(one.ok for one in found), "the caps came on meanwhile"
    assert (at.wires.clock.now_ns() - begun_ns) / 1e9 == pytest.approx(1.5)


@pytest.mark.parametrize(
    ("event", "over", "ended_by"),
    [
        (None, False, None), (api.Pulse(0, 1, 2), False, None), (api.PulsesDone(64), True, None), (api.BoardLost("unplugged"), True, "the board was lost (unplugged)"),
        (api.BoardBooted("1.4", "KF", "BROWNOUT"), True, "the board restarted (BROWNOUT)"), (api.VsyncLost(), True, "the board saw no more vertical syncs"),
    ],
)  # fmt: skip
def test_what_the_board_says_ends_a_series_or_does_not(event: Any, over: bool, ended_by: str | None) -> None:
    series = endurance._PulseCount()
    assert (series.take(event), series.ended_by, series.reported) == (over, ended_by, isinstance(event, api.Pulse))


def recording(frames: list[api.Frame], **more: Any) -> SideRecording:
    return SideRecording(np.zeros((64, 1, 1), np.uint8), lambda _index: None, frames=frames, **more)


@pytest.mark.parametrize(
    ("made", "wanted"),
    [
        (recording([frame(k) for k in (5, 6, 7)]), CameraEndurance(3, (), 0, 0)),
        (recording([frame(k) for k in (5, 6, 8, 8)]), CameraEndurance(4, (), 0, 2)),
        (recording([frame(5), frame(6, block_id=None), frame(7)]), CameraEndurance(3, (), 0, 1)),
        (recording([frame(5), frame(6, camera_time_ns=None)]), CameraEndurance(2, (), 1, 0)),
        (recording([frame(5), frame(6, api.FrameStatus.TRUNCATED)]), CameraEndurance(1, ("truncated",), 0, 0)),
        (recording([frame(5), frame(6, api.FrameStatus.TIMEOUT)]), CameraEndurance(1, ("timeout",), 0, 0)),
        (recording([frame(5), frame(6, api.FrameStatus.TIMEOUT)], cancelled=True), CameraEndurance(1, (), 0, 0)),
        (
            recording([frame(5), frame(6, api.FrameStatus.CORRUPT)], cancelled=True),
            CameraEndurance(1, ("corrupt",), 0, 0),
        ),
        (recording([frame(5)], cancelled=True, lost="unplugged"), CameraEndurance(1, (), 0, 0, "unplugged")),
        (recording([], cancelled=True), CameraEndurance(0, (), 0, 0)),
    ],
)
def test_a_camera_is_charged_with_what_is_its_own_fault(made: SideRecording, wanted: CameraEndurance) -> None:
    assert endurance._camera_endurance(made) == wanted


class BenchGrabber:
    """One camera's thread, as far as an endurance run asks it: it is ready and done as the test says."""

    def __init__(self, clock: SteppedClock, ready: bool = True) -> None:
        self.clock, self.ready = clock, ready
        self.waits: list[tuple[str, float]] = []
        self.cancelled: list[SideRecording] = []
        self.temperature_c: float | None = 33.0
        self.recorded: NDArray[np.uint8] = np.zeros(0, np.uint8)

    def record(self, slots: Any, _on_frame: Any) -> SideRecording:
        self.recorded = slots
        return recording([])

    def wait(self, one: SideRecording, what: str, timeout_s: float) -> bool:
        self.waits.append((what, timeout_s))
        return one.done or (what == "ready" and self.ready)

    def cancel(self, one: SideRecording) -> None:
        self.cancelled.append(one)


def fires(board: BenchBoard, prepare: Callable[[int], object] = lambda _series: None) -> None:
    """Each series that is armed is reported pulse by pulse; ``prepare`` takes its number, and may end it by saying False."""
    armed: list[int] = []

    def fire(command: tuple[Any, ...]) -> None:
        if command[0] == "arm":
            armed.append(board.clock.now_ns())
            if prepare(len(armed)) is not False:
                for k in range(64):
                    board.events.at_s((k + 3) / 60.0, api.Pulse(k, k, 0))
                board.events.at_s(66.5 / 60.0, api.PulsesDone(64))

    board.when = fire


class Fired:
    """What an endurance run of three series goes through."""

    def __init__(self, right_starts: bool = True) -> None:
        self.at = workplace()[0]
        clock: Any = self.at.wires.clock
        self.board = BenchBoard(clock)
        self.recordings = {side: recording([]) for side in ("left", "right")}
        self.grabbers = {"left": BenchGrabber(clock), "right": BenchGrabber(clock, right_starts)}

    def run(self, prepare: Callable[[int], object] = lambda _series: None) -> endurance._PulseCount:
        fires(self.board, prepare)
        return endurance._fire(self.at, self.board, self.grabbers, self.recordings, 3)  # type: ignore[arg-type]


def test_a_camera_that_does_not_start_ends_it_before_the_first_pulse() -> None:
    with pytest.raises(BringupError, match=r"camera.right did not start within 2 s; run `kingfisher check`"):
        Fired(right_starts=False).run()


def test_a_silent_board_ends_it_after_the_length_of_a_series_and_some_seconds() -> None:
    one = Fired()
    found = one.run(lambda _series: False)
    assert (found.requested, found.reported, found.ended_by) == (64, 0, "the board did not report the end of the run")
    assert (one.board.clock.now_ns() / 1e9 - 1.0) == pytest.approx(64 / 60.0 + 5.0, abs=0.3)
    assert one.grabbers["left"].waits == [("ready", 2.0)], "nobody waits for frames that do not come"


@pytest.mark.parametrize(
    ("number", "asked", "ended_by"), [(1, 64, "camera.left"), (2, 128, "camera.left"), (3, 192, None)]
)
def test_a_camera_that_lost_a_frame_ends_it_but_for_the_last_series(
    number: int, asked: int, ended_by: str | None
) -> None:
    one = Fired()

    def lose(series: int) -> None:
        if series == number:
            one.recordings["left"].frames.append(frame(0, api.FrameStatus.CORRUPT))
            one.recordings["left"].done = True

    found = one.run(lose)
    assert (found.requested, found.ended_by) == (asked, ended_by)


def warm(case_c: float) -> api.Telemetry:
    return api.Telemetry(0, 0, 0, api.LaserState(False, False), 50.0, case_c, 45.0)


@pytest.mark.parametrize(("minutes", "series", "unplugged"), [(0.0, 1, False), (0.1, 6, False), (0.05, 3, True)])
def test_a_run_is_as_long_as_was_asked_and_cameras_are_let_go_whatever_happens(
    minutes: float, series: int, unplugged: bool
) -> None:
    clock = SteppedClock()
    at, _, _ = workplace(clock, minutes=minutes)
    board, grabbers = BenchBoard(clock), {side: BenchGrabber(clock) for side in ("left", "right")}
    grabbers["right"].temperature_c = None

    def unplug(_series: int) -> None:
        if unplugged:
            raise api.DeviceGone("board", "unplugged", "")

    fires(board, unplug)
    board.events.at_s(0.5, warm(20.0))
    if unplugged:
        with pytest.raises(api.DeviceGone):
            endurance._run_endurance(at, grabbers, board)  # type: ignore[arg-type]
    else:
        seen = endurance._run_endurance(at, grabbers, board)  # type: ignore[arg-type]
        assert (seen.pulses, seen.reported, seen.lost_reports) == (64 * series, 64 * series, 0)
        assert (seen.wanted_minutes, seen.ended_by) == (minutes, None)
        # 66.5 periods each, its last exposure, and one millisecond more.
        assert seen.minutes == pytest.approx(series * (66.5 / 60.0 + 0.013) / 60.0)
        warmth = {"projector": 50.0, "case": 20.0, "board": 45.0, "camera.left": 33.0, "camera.right": None}
        assert (seen.before_c, seen.after_c["case"]) == (warmth, None)
        assert seen.cameras == dict.fromkeys(("left", "right"), CameraEndurance(0, (), 0, 0))
    assert ("stop",) in board.commands
    for one in grabbers.values():
        assert one.recorded.shape == (64 * series, 300, 400)
        assert len(one.cancelled) == 1


SEQUENCE = build_sequence(64, 512, 384)
BRIGHT, DARK = SEQUENCE.bright, SEQUENCE.dark


def flat(bright: int, dark: int) -> NDArray[np.uint8]:
    frames = np.zeros((len(SEQUENCE), 10, 10), np.uint8)
    frames[BRIGHT], frames[DARK] = bright, dark
    return frames


@pytest.mark.parametrize(
    ("saturates_from_us", "tried"), [(9_000, [8_000]), (8_000, [8_000, 4_000]), *((us, [8_000, 4_000, 2_000, 1_000]) for us in (1_500, 0))]
)  # fmt: skip
def test_the_plane_is_recorded_darker_until_neither_camera_saturates(saturates_from_us: int, tried: list[int]) -> None:
    made: list[int] = []

    def record(exposure: Exposure) -> tuple[Any, plane.Frames]:
        made.append(exposure.time_us)
        right = flat(255 if exposure.time_us >= saturates_from_us else 200, 10)
        return len(made), {"left": flat(200, 10), "right": right}

    allowed = tuple(Exposure(1000 * k) for k in (1, 2, 4, 8, 16))
    report: Any
    report, frames, exposure = plane._record_unsaturated(record, SEQUENCE, allowed, Exposure(8_000))
    assert made == tried
    assert (made.index(exposure.time_us), report) == (len(tried) - 1, len(tried)), "the last one is that of the scan"
    assert (frames["right"][BRIGHT, 0, 0] == 255) == (saturates_from_us <= tried[-1])


def test_a_first_scan_is_stored_with_everything_that_is_known_of_it(tmp_path: Path) -> None:
    rig = load_rig(RIG_FILE)
    rig = replace(rig, storage=replace(rig.storage, root=tmp_path))
    at, _, told = workplace(rig=rig)
    today = SimpleNamespace(utc=datetime.datetime(2031, 5, 6, 7, 8, 9, 500, tzinfo=datetime.UTC), kept=True)
    wires: Any = SimpleNamespace(clock=at.wires.clock, calendar=SimpleNamespace(today=lambda: today))
    at = replace(at, wires=wires)
    report = CaptureReport(None, ledger([frame(k) for k in range(64)]), 1.0, ())
    seen = np.random.default_rng(8).integers(0, 255, (len(SEQUENCE), 72, 96)).astype(np.uint8)
    frames = dict.fromkeys(("left", "right"), seen)
    scan_id = plane._store(at, report, frames, SEQUENCE, Exposure(4_000, 2.0), "ab" * 32)
    folder = Library(tmp_path).entry(scan_id).folder
    scan = StoredScan.load(folder)
    np.testing.assert_array_equal(scan.frames["left"], frames["left"])
    record = scan.manifest.record
    assert (record.wall_time, record.clock_trusted) == ("2031-05-06T07:08:09+00:00", True)
    assert (record.exposure, record.response_hash) == (Exposure(4_000, 2.0), "ab" * 32)
    assert (record.rig_hash, record.software_version) == (rig.rig_hash, appliance.__version__)
    assert (record.calibration_hash, record.recorded_ns) == (Instrument(rig).design().hash, wires.clock.now_ns())
    assert record.water == {"temperature_c": 20.0, "salinity_psu": 0.0, "wavelength_nm": 530.0}
    assert record.ledger is not None
    assert record.ledger["expected"] == 64
    assert (folder / "rig.toml").read_text(encoding="utf-8") == rig_text(rig)
    flatness, why_not, faults = plane._reprocess(at, scan_id)
    assert (flatness, faults) == (None, ())
    assert "there is no calibration yet" in why_not
    assert told.all == []


@pytest.mark.parametrize(("left_dn", "right_dn", "asked"), [(5, 5, 1), (5, 4, 3), (4, 5, 3), (0, 0, 3)])
def test_a_wall_is_asked_for_until_both_cameras_see_light_on_it(left_dn: int, right_dn: int, asked: int) -> None:
    lights = {"left": left_dn, "right": right_dn}

    def seen(side: str, _shot: Any, _take: int) -> Any:
        frames = np.full((24, 8, 8), 10)
        # It comes late by more blanks than any projector.
        frames[20:] += lights[side]
        return frames

    at, person, told = workplace()
    bench: Any = ValueBench(seen)
    projector._before_white(at, bench)
    assert len(person.said) == len(told.all) == asked
    assert person.said[0] == f"{wall(at)}, and darken the room"
    assert ["(attempt " in one for one in person.said] == [False, True, True][:asked]
    assert bench.taken[0][0] == [0] * 12 + [1] * 12
    shot = bench.taken[0][1]
    assert (shot.delay_us, shot.exposure_us, shot.gain_db) == (500, 12_000, 0.0)
    (black, white), all_channels = bench.loaded[0]
    assert black.shape == white.shape == (48, 64)
    assert (black.max(), white.min(), all_channels) == (0, 255, False)
