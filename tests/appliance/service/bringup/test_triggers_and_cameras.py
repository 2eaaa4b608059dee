"""What is made of frames: of triggers that were fired, of covered cameras, and of minutes at full rate, from values alone."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.bringup.bench import Shot
from appliance.bringup.camera_check import judge_settings
from appliance.bringup.endurance_check import SideEndured
from appliance.bringup.finding import BringupError
from appliance.capture.grabber import SideRecording
from appliance.capture.ledger import Ledger
from appliance.capture.timeouts import Timeouts
from appliance.config import load_rig
from appliance.instrument import noise_of
from appliance.service.bringup import cameras, endurance
from appliance.service.bringup.trigger import fired, trigger_findings
from drivers.api import (
    BoardBooted,
    BoardLost,
    CameraIdentity,
    CameraSettings,
    DeviceGone,
    Frame,
    FrameStatus,
    HeldSetting,
    LaserState,
    Pulse,
    PulsesDone,
    Telemetry,
    VsyncLost,
)
from tests.appliance.service.bringup.scripted import (
    PERIOD_NS,
    RIG_FILE,
    BenchBoard,
    ValueBench,
    with_camera,
    workplace,
)
from tests.drivers.clock import SteppedClock

RIG = load_rig(RIG_FILE)
BLACK_DN = RIG.camera.left.black_level_dn


def frame(k: int, status: FrameStatus = FrameStatus.COMPLETE, **more: Any) -> Frame:
    made: dict[str, Any] = {"block_id": k, "camera_time_ns": round(k * PERIOD_NS) + 77, "received_ns": 0, **more}
    return Frame(status, **made)


def ledger(left: list[Frame], pulses: int = 64) -> Ledger:
    reported = tuple(Pulse(k, k, round(k * PERIOD_NS / 1000.0)) for k in range(pulses))
    right = tuple(frame(k) for k in range(64))
    return Ledger(64, PERIOD_NS, None, None, 500, (), reported, {"left": tuple(left), "right": right}, None)


def told(left: list[Frame], pulses: int = 64) -> dict[str, bool]:
    return {one.name: one.ok for one in trigger_findings(ledger(left, pulses))}


# ----------------------------------------------------------------------------------------- triggers


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


def test_a_frame_that_never_came_is_no_bad_one_and_a_damaged_one_is() -> None:
    whole = [frame(k) for k in range(20)]
    (found,) = (
        one for one in trigger_findings(ledger([*whole, frame(20, FrameStatus.TIMEOUT)])) if one.name == "camera.left"
    )
    assert found.said.startswith("20 frames of 64 pulses: some")
    (found,) = (
        one for one in trigger_findings(ledger([*whole, frame(20, FrameStatus.CORRUPT)])) if one.name == "camera.left"
    )
    assert found.said == "20 frames of 64 pulses; one arrived corrupt"


def test_sixty_four_triggers_are_fired_before_a_black_picture_as_the_rig_file_says() -> None:
    bench: Any = ValueBench(lambda *_: np.zeros((64, 4, 4), np.uint8))
    rig = replace(with_camera(RIG, exposure_ms=7.5, gain_db=3.0), board=replace(RIG.board, trigger_delay_us=900))
    fired(bench, rig)
    fired(bench, rig, 500)
    assert bench.taken == [([0] * 64, Shot(900, 7500, 3.0)), ([0] * 64, Shot(900, 500, 3.0))]
    (picture,), all_channels = bench.loaded[0]
    assert picture.shape == (768, 1024)
    assert not picture.any()
    assert all_channels is False


# ------------------------------------------------------------------------------------------ covered


def dark(light_dn: float = 0.0, until_take: int = 10**9) -> ValueBench:
    """Cameras whose longer exposures are brighter by ``light_dn`` in the first takes; only the last 16 frames are calm."""
    rng = np.random.default_rng(1)
    frames = BLACK_DN + noise_of(RIG).left.read_dn * rng.standard_normal((64, 16, 24))
    frames[:48] += 100.0
    short, long = (np.clip(np.rint(one), 0, 255).astype(np.uint8) for one in (frames, frames + light_dn))
    return ValueBench(lambda _side, shot, take: long if shot.exposure_us > 500 and take <= until_take else short)


def test_covered_cameras_are_good_at_once_by_their_last_sixteen_frames() -> None:
    at, person, _ = workplace()
    bench: Any = dark()
    found, pictures = cameras._dark(at, bench)
    assert all(one.ok for one in found), found
    assert [one.name.split(" ", 1)[1] for one in found] == ["light", "black", "noise", "hot pixels"] * 2
    assert person.said == ["put the caps on both lenses"]
    assert [shot.exposure_us for _, shot in bench.taken] == [500, 12_000]
    assert list(pictures) == ["dark_left.png", "dark_right.png"]
    assert at.wires.clock.now_ns() == SteppedClock().now_ns(), "nothing is waited for"


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


def test_without_triggers_covered_cameras_say_what_the_trigger_step_would() -> None:
    at, _, _ = workplace()
    bench: Any = dark()
    bench.fault, bench.ledger = object(), ledger([])
    found, pictures = cameras._dark(at, bench)
    assert found == list(trigger_findings(ledger([])))
    assert pictures == {}
    assert len(bench.taken) == 1


def test_a_dark_picture_is_shown_eight_times_brighter() -> None:
    image = np.full((4, 6), 5, np.uint8)
    image[0, 0] = 40
    caption, data = cameras._pictures({"left": image})["dark_left.png"]
    assert caption == "Covered, 8 times brighter (left camera)"
    shown = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert shown is not None
    assert (int(shown[0, 0]), int(shown[2, 2])) == (255, 40)


@pytest.mark.parametrize(
    ("held", "shown"),
    [
        (HeldSetting("Gamma", None, None), "not offered"),
        (HeldSetting("Gamma", 1.0, 1.0), "1"),
        (HeldSetting("Width", 640, 640), "640"),
        (HeldSetting("ExposureTime", None, 12.5), "12.5"),
        (HeldSetting("TriggerMode", "On", "Off"), "Off (asked for On)"),
    ],
)
def test_a_setting_is_shown_as_it_is_held_and_as_asked_for_where_they_differ(held: HeldSetting, shown: str) -> None:
    assert cameras._shown(held) == shown


def test_only_a_camera_that_can_be_asked_is_asked_for_its_settings() -> None:
    class Readable:
        def read_back(self) -> tuple[HeldSetting, ...]:
            return (HeldSetting("Gamma", 1.0, 1.0),)

    readable: Any = Readable()
    dumb: Any = object()
    assert cameras._held(readable) == (HeldSetting("Gamma", 1.0, 1.0),)
    assert cameras._held(dumb) is None


# ---------------------------------------------------------------------------------------- endurance


@pytest.mark.parametrize(
    ("event", "over", "ended_by"),
    [
        (None, False, None),
        (Pulse(0, 1, 2), False, None),
        (PulsesDone(64), True, None),
        (BoardBooted("1.4", "KF", "BROWNOUT"), True, "the board restarted (BROWNOUT)"),
        (BoardLost("unplugged"), True, "the board was lost (unplugged)"),
        (VsyncLost(), True, "the board saw no more vertical syncs"),
    ],
)
def test_what_the_board_says_ends_a_series_or_does_not(event: Any, over: bool, ended_by: str | None) -> None:
    series = endurance._Fired()
    assert (series.take(event), series.ended_by) == (over, ended_by)
    assert series.reported == isinstance(event, Pulse)


def test_all_images_of_a_camera_lie_in_one_memory() -> None:
    slots = endurance._one_slot(30, 40, 6400)
    assert slots["left"].shape == slots["right"].shape == (6400, 30, 40)
    slots["left"][0, 3, 7] = 9
    assert slots["left"][6399, 3, 7] == 9
    assert slots["left"][5, 7, 3] == 0
    assert not slots["right"].any()


def recording(frames: list[Frame], **more: Any) -> SideRecording:
    return SideRecording(np.zeros((64, 1, 1), np.uint8), lambda _index: None, frames=frames, **more)


@pytest.mark.parametrize(
    ("made", "wanted"),
    [
        (recording([frame(k) for k in (5, 6, 7)]), SideEndured(3, (), 0, 0)),
        (recording([frame(k) for k in (5, 6, 8, 8)]), SideEndured(4, (), 0, 2)),
        (recording([frame(5), frame(6, block_id=None), frame(7)]), SideEndured(3, (), 0, 1)),
        (recording([frame(5), frame(6, camera_time_ns=None)]), SideEndured(2, (), 1, 0)),
        (recording([frame(5), frame(6, FrameStatus.TRUNCATED)]), SideEndured(1, ("truncated",), 0, 0)),
        (recording([frame(5), frame(6, FrameStatus.TIMEOUT)]), SideEndured(1, ("timeout",), 0, 0)),
        (recording([frame(5), frame(6, FrameStatus.TIMEOUT)], cancelled=True), SideEndured(1, (), 0, 0)),
        (recording([frame(5), frame(6, FrameStatus.CORRUPT)], cancelled=True), SideEndured(1, ("corrupt",), 0, 0)),
        (recording([frame(5)], cancelled=True, lost="unplugged"), SideEndured(1, (), 0, 0, "unplugged")),
        (recording([], cancelled=True), SideEndured(0, (), 0, 0)),
    ],
)
def test_a_camera_is_charged_with_what_is_its_own_fault(made: SideRecording, wanted: SideEndured) -> None:
    assert endurance._endured(made) == wanted


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


def run(
    series: int = 3, prepare: Any = lambda *_: None, ready: bool = True
) -> tuple[endurance._Fired, BenchBoard, dict[str, BenchGrabber], Any]:
    """An endurance run of some series, whose every pulse is reported; ``prepare`` takes board, recordings and number of each."""
    at, _, told_ = workplace()
    clock: Any = at.wires.clock
    board = BenchBoard(clock)
    recordings = {side: recording([]) for side in ("left", "right")}
    grabbers = {"left": BenchGrabber(clock), "right": BenchGrabber(clock, ready)}
    armed: list[int] = []

    def fire(command: tuple[Any, ...]) -> None:
        if command[0] != "arm":
            return
        armed.append(clock.now_ns())
        if prepare(board, recordings, len(armed)) is not False:
            for k in range(64):
                board.events.at_s((k + 3) / 60.0, Pulse(k, k, 0))
            board.events.at_s(66.5 / 60.0, PulsesDone(64))

    board.when = fire
    found = endurance._fire(at, board, grabbers, recordings, series)  # type: ignore[arg-type]
    return found, board, grabbers, told_


def test_series_follow_each_other_once_the_last_pulse_has_ended() -> None:
    found, board, grabbers, told_ = run()
    assert (found.asked, found.reported, found.ended_by) == (192, 192, None)
    arms = [command for command in board.commands if command[0] == "arm"]
    assert {(pulses, delay_us, width_us) for _, pulses, _, delay_us, width_us in arms} == {(64, 500, 12_000)}
    # Three syncs after the one that was asked for; a series takes 66.5 periods, the last pulse 12 ms and one more.
    assert arms[0][2] == 60 + 3
    assert arms[1][2] == int((1.0 + 66.5 / 60.0 + 0.013) * 60.0) + 3
    assert told_.all == [("endurance", k / 3) for k in range(3)]
    for one in grabbers.values():
        assert one.waits == [("ready", 2.0), ("done", 2.5)]


def test_a_camera_that_does_not_start_ends_it_before_the_first_pulse() -> None:
    with pytest.raises(BringupError, match=r"camera.right did not start within 2 s; ask `kingfisher check`"):
        run(ready=False)


def test_a_silent_board_ends_it_after_the_length_of_a_series_and_some_seconds() -> None:
    found, board, grabbers, _ = run(prepare=lambda *_: False)
    assert (found.asked, found.reported) == (64, 0)
    assert found.ended_by == "the board did not say that it was done"
    assert (board.clock.now_ns() / 1e9 - 1.0) == pytest.approx(64 / 60.0 + 5.0, abs=0.3)
    assert grabbers["left"].waits == [("ready", 2.0)], "nobody waits for frames that do not come"


@pytest.mark.parametrize(
    ("number", "asked", "ended_by"), [(1, 64, "camera.left"), (2, 128, "camera.left"), (3, 192, None)]
)
def test_a_camera_that_lost_a_frame_ends_it_but_for_the_last_series(
    number: int, asked: int, ended_by: str | None
) -> None:
    def lose(_board: BenchBoard, recordings: dict[str, SideRecording], k: int) -> None:
        if k == number:
            recordings["left"].frames.append(frame(0, FrameStatus.CORRUPT))
            recordings["left"].done = True

    found = run(prepare=lose)[0]
    assert (found.asked, found.ended_by) == (asked, ended_by)


def test_a_camera_that_has_all_its_frames_does_not_end_it_and_the_boards_word_comes_first() -> None:
    def finish(board: BenchBoard, recordings: dict[str, SideRecording], k: int) -> None:
        recordings["left"].frames[:] = [frame(n) for n in range(64)]
        recordings["left"].done = True
        if k == 2:
            recordings["right"].done = True
            board.events.at_s(0.5, VsyncLost())

    found = run(prepare=finish)[0]
    assert (found.asked, found.ended_by) == (128, "the board saw no more vertical syncs")


def test_who_still_records_is_let_go_and_waited_for() -> None:
    clock = SteppedClock()
    grabbers: Any = {side: BenchGrabber(clock) for side in ("left", "right")}
    recordings = {"left": recording([]), "right": recording([], done=True)}
    endurance._end(grabbers, recordings, Timeouts(60.0))
    assert grabbers["left"].cancelled == [recordings["left"]]
    assert grabbers["left"].waits == [("done", 2.5)]
    assert grabbers["right"].cancelled == []


def temperatures(*events: tuple[float, Any]) -> tuple[dict[str, float | None], float]:
    clock = SteppedClock()
    board, grabbers = BenchBoard(clock), {"left": BenchGrabber(clock)}
    for time_s, event in events:
        board.events.at_s(time_s, event)
    found = endurance._temperatures(grabbers, board, clock)  # type: ignore[arg-type]
    return found, clock.now_ns() / 1e9 - 1.0


def warm(case_c: float) -> Telemetry:
    return Telemetry(0, 0, 0, LaserState(False, False), 50.0, case_c, 45.0)


def test_temperatures_are_those_of_the_latest_heartbeat_of_one_and_a_half_seconds() -> None:
    found, took_s = temperatures(*((0.5 * k, warm(20.0 + k)) for k in range(1, 9)), (1.6, Pulse(0, 0, 0)))
    assert found == {"projector": 50.0, "case": 23.0, "board": 45.0, "camera.left": 33.0}
    assert took_s == pytest.approx(1.6)


def test_a_heartbeat_that_is_late_is_waited_for_and_a_silent_board_has_no_temperature() -> None:
    busy = [(0.01 * k, Pulse(k, k, k)) for k in range(1, 300)]
    assert temperatures(*busy, (2.0, warm(25.0)))[0]["case"] == 25.0
    found, took_s = temperatures()
    assert found == {"projector": None, "case": None, "board": None, "camera.left": 33.0}
    assert took_s == pytest.approx(1.875)
    assert temperatures(*((0.005 * k, Pulse(k, k, k)) for k in range(1, 1000)))[1] == pytest.approx(2.0), "not for ever"


def test_a_board_without_counters_has_lost_nothing() -> None:
    board: Any = SimpleNamespace()
    assert endurance._lost_reports(board) == 0


@pytest.mark.parametrize(("minutes", "series"), [(0.0, 1), (0.05, 3), (0.1, 6)])
@pytest.mark.parametrize("unplugged", [False, True])
def test_a_run_is_as_long_as_was_asked_and_cameras_are_let_go_whatever_happens(
    minutes: float, series: int, unplugged: bool
) -> None:
    clock = SteppedClock()
    at, _, _ = workplace(clock, minutes=minutes)
    board, grabbers = BenchBoard(clock), {side: BenchGrabber(clock) for side in ("left", "right")}
    grabbers["right"].temperature_c = None

    def fire(command: tuple[Any, ...]) -> None:
        if command[0] == "arm":
            if unplugged:
                raise DeviceGone("board", "unplugged", "")
            for k in range(64):
                board.events.at_s((k + 3) / 60.0, Pulse(k, k, 0))
            board.events.at_s(66.5 / 60.0, PulsesDone(64))

    board.when = fire
    board.events.at_s(0.5, warm(20.0))
    if unplugged:
        with pytest.raises(DeviceGone):
            endurance._endure(at, grabbers, board)  # type: ignore[arg-type]
    else:
        seen = endurance._endure(at, grabbers, board)  # type: ignore[arg-type]
        assert (seen.pulses, seen.reported, seen.lost_reports) == (64 * series, 64 * series, 0)
        assert (seen.wanted_minutes, seen.ended_by) == (minutes, None)
        # 66.5 periods each, its last exposure, and one millisecond more.
        assert seen.minutes == pytest.approx(series * (66.5 / 60.0 + 0.013) / 60.0)
        assert seen.before_c == {
            "projector": 50.0,
            "case": 20.0,
            "board": 45.0,
            "camera.left": 33.0,
            "camera.right": None,
        }
        assert seen.after_c["case"] is None
        assert seen.cameras == {"left": SideEndured(0, (), 0, 0), "right": SideEndured(0, (), 0, 0)}
    assert ("stop",) in board.commands
    for one in grabbers.values():
        assert one.recorded.shape == (64 * series, 300, 400)
        assert len(one.cancelled) == 1


class SetCamera:
    """A camera that keeps what it was set to."""

    slow_link: str | None = None
    identity = CameraIdentity("Reef", "Eye", "1", "1.2", 5000)

    def __init__(self, held: tuple[HeldSetting, ...] = ()) -> None:
        self.settings: list[CameraSettings] = []
        self._held = held

    def configure(self, settings: CameraSettings) -> CameraSettings:
        self.settings.append(settings)
        return settings

    def read_back(self) -> tuple[HeldSetting, ...]:
        return self._held


def test_a_camera_is_set_as_every_scan_sets_it_and_its_settings_are_judged() -> None:
    held = (HeldSetting("GammaEnable", False, False), HeldSetting("Gamma", 1.0, 0.5))
    camera: Any = SetCamera(held)
    findings, read = cameras._settled(camera, "left", replace(RIG.camera.left, exposure_ms=7.5, gain_db=2.0))
    assert camera.settings == [CameraSettings(400, 300, 7500.0, 2.0)]
    assert read == held
    assert findings[0].name == "camera.left link"
    assert findings[1:] == list(judge_settings("left", held))


def test_a_camera_behind_a_slow_link_is_not_set_and_one_that_cannot_be_asked_is_good() -> None:
    camera: Any = SetCamera()
    camera.slow_link = "the link runs at 480 Mbit/s"
    ((link,), held) = cameras._settled(camera, "right", RIG.camera.right)
    assert (link.ok, held, camera.settings) == (False, (), [])
    dumb: Any = SimpleNamespace(slow_link=None, identity=SetCamera.identity, configure=lambda _settings: None)
    (_, settings), held = cameras._settled(dumb, "right", RIG.camera.right)
    assert (settings.name, settings.ok, held) == ("camera.right settings", True, ())
