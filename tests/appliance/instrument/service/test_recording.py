"""From the wish for a sequence to its frames, and the heartbeat that it goes on under, on devices that follow a script."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from appliance.instrument.machine import effects as do
from appliance.instrument.machine import events as on
from appliance.instrument.machine.states import Device, State
from appliance.instrument.machine.words import Language
from appliance.instrument.screens.painter import Painter
from appliance.instrument.service.inputs import Inputs
from appliance.instrument.service.loop import Drawing, Service
from appliance.instrument.service.parts import LiveViews, StartFacts
from appliance.instrument.service.recording import DrawnPatterns, SequenceRecorder
from appliance.instrument.service.remembered import ChoicesFile
from appliance.instrument.service.settings import standard_choices
from appliance.instrument.service.status import StatusFile
from appliance.instrument.service.watchdog import ServiceManager, Watchdog
from appliance.measure.fault import Fault, FaultCode
from appliance.measure.light.exposure import Exposure
from appliance.store.library import Library
from drivers import api
from drivers.api import BoardBooted, KeyFreed, KeyLongPress, KeyPress, KeyStuck
from drivers.output.gl import open_gl
from tests.appliance.instrument.capture.test_course_of_a_scan import BEAT, SEQUENCE, N
from tests.appliance.instrument.machine.walks import PARTS, SUMMARY, UPS, run
from tests.appliance.instrument.service.scripted import Desk, a_desk, small_rig
from tests.drivers.clock import SteppedClock
from tests.support import news

EXPOSURE = Exposure(8_000, 6.0)
WANTED = do.Arm(7, 16, EXPOSURE, object=5)


@pytest.fixture(scope="module")
def drawing(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Drawing]:
    rig = small_rig(tmp_path_factory.mktemp("rig"))
    size_px = rig.display.width_px, rig.display.height_px
    with open_gl() as gl, Painter(gl, size_px, Language.ENGLISH) as painter:
        yield Drawing(DrawnPatterns(gl, rig, 64, None), painter)


@pytest.fixture
def inputs(desk: Desk) -> Inputs:
    return Inputs(desk.devices, desk.parts.ranging)


@pytest.fixture
def one(desk: Desk, inputs: Inputs, drawing: Drawing) -> SequenceRecorder:
    return SequenceRecorder(desk.rig, desk.parts, drawing.patterns, inputs, desk.script.clock, desk.inbox)


def nothing() -> None:
    """Draw nothing, abort nothing."""


def answered(desk: Desk, one: SequenceRecorder) -> list[on.Event]:
    told: list[on.Event] = []
    desk.until(lambda: told.extend(one.go_on()) or told)  # type: ignore[func-returns-value]
    return told


def test_a_sequence_is_armed_played_and_taken_down(desk: Desk, one: SequenceRecorder) -> None:
    drawn: list[str] = []
    one.request(WANTED)
    assert answered(desk, one) == [on.Armed(7)]
    assert one.go_on() == [], "told once"
    desk.script.before = [BEAT]
    assert one.play(7, lambda: drawn.append("screen"), nothing) == on.CaptureFinished(7)
    assert drawn == ["screen"]
    scan = desk.parts.scans.scan
    assert scan is not None
    assert (scan.number, scan.belongs_to, scan.exposure) == (7, 5, EXPOSURE)
    assert scan.record is not None
    assert set(scan.record.temperatures_c) == {"projector", "case", "board", "camera_left", "camera_right"}
    assert desk.parts.scans.store.frames("right")[:, 1, 2].tolist() == list(range(1, N + 1))
    assert one.play(7, nothing, nothing) == on.CaptureFailed(7, Fault(FaultCode.INTERNAL, "nothing was armed"))


@pytest.mark.parametrize("device", ["board", "projector", "left", "right"])
def test_without_all_devices_nothing_is_armed(desk: Desk, one: SequenceRecorder, device: str) -> None:
    parts: dict[str, Any] = {"board": desk.devices.board, "projector": desk.devices.projector, **desk.devices.cameras}
    parts[device].lose("unplugged")
    one.request(WANTED)
    assert one.go_on() == []
    (failed,) = desk.inbox
    assert isinstance(failed, on.CaptureFailed)
    assert (failed.number, failed.fault.code) == (7, FaultCode.INTERNAL)
    assert failed.fault.detail == "a capture was requested without all devices"
    assert desk.parts.scans.scan is None


def test_nothing_is_begun_while_the_disk_is_busy(desk: Desk, one: SequenceRecorder) -> None:
    gate = threading.Event()
    desk.parts.scans.submit(lambda: gate.wait(10.0))
    desk.parts.scans.count()
    one.request(WANTED)
    assert one.go_on() == []
    assert desk.parts.scans.scan is None
    one.request_period(64)
    assert one.go_on() == []
    assert desk.parts.scans.sequence is SEQUENCE
    gate.set()


def test_what_is_let_go_answers_nothing_and_frees_its_memory(desk: Desk, one: SequenceRecorder) -> None:
    one.request(WANTED)
    one.go_on()
    assert [desk.parts.scans.scan is None] == [False]
    one.let_go()
    assert [desk.parts.scans.scan] == [None]
    assert one.go_on() == []


def test_patterns_of_another_period_are_drawn_loaded_and_recorded_with(desk: Desk, one: SequenceRecorder) -> None:
    before = desk.parts.scans.store
    one.request_period(16)
    one.go_on()
    assert desk.parts.scans.store is before, "they are in use"
    one.request_period(64)
    one.go_on()
    sequence = desk.parts.scans.sequence
    assert (sequence.period_px, sequence.width_px) == (64, desk.rig.projector.width_px)
    assert desk.said() == [f"load {len(sequence) + 2}", f"show {len(sequence)}"], "behind them: dark, live light"
    assert len(desk.parts.scans.store.frames("left")) == len(sequence)


DARK, LIT = len(SEQUENCE), len(SEQUENCE) + 1


@pytest.mark.parametrize(("light", "shown"), [(True, LIT), (False, DARK)])
def test_the_lasers_are_off_and_the_light_is_as_wanted_before_the_board_fires(
    desk: Desk, light: bool, shown: int
) -> None:
    live = LiveViews(desk.rig, desk.parts, desk.inbox)
    live.begin(do.GoLive(light, True, EXPOSURE), aiming=True, belongs_to=3)
    board = desk.rig.board
    fired = f"live every {board.live_every_vsyncs} delay {board.trigger_delay_us} width 8000"
    told = [said for said in desk.said() if not said.startswith(("left", "right"))]
    assert told == [f"show {shown}", "stop", "lasers False False", fired]
    desk.until(lambda: all(said == ["start"] for said in desk.script.cameras.values()))
    live.end()
    told = [said for said in desk.said() if not said.startswith(("left", "right"))]
    assert told == [f"show {DARK}", "lasers False False", "stop"]
    assert desk.inbox == []


def test_each_camera_is_exposed_as_wanted_and_shows_its_latest_image(desk: Desk) -> None:
    live = LiveViews(desk.rig, desk.parts, desk.inbox)
    live.begin(do.GoLive(True, False, EXPOSURE), aiming=False, belongs_to=None)
    desk.until(lambda: all(said == ["start"] for said in desk.script.cameras.values()))
    assert {"left 8000 us 6 dB", "right 8000 us 6 dB"} <= set(desk.said())

    def seen() -> dict[str, int]:
        live.take()
        return {side: int(image[0, 0]) for side, image in live.images.items()}

    for shown in (1, 2):
        desk.script.show(shown)
        desk.until(lambda: seen() == dict.fromkeys(("left", "right"), shown))  # noqa: B023  # it has ended by then
    desk.devices.cameras["left"].lose("unplugged")
    assert set(seen()) == {"right"}, "an old image is no live one"
    desk.until(desk.devices.poll)  # it comes back, and its images are counted anew
    left = desk.devices.cameras["left"].value
    assert left is not None
    left.live()
    desk.until(lambda: seen() == {"left": 2, "right": 2})


WARM = api.Telemetry(0, 0, 0, api.LaserState(False, False), 41.0, 36.5, 30.0)


def test_each_report_of_the_board_means_what_it_says(inputs: Inputs, caplog: pytest.LogCaptureFixture) -> None:
    assert [inputs.telemetry] == [None]
    assert inputs.board_event(WARM) == [WARM]
    assert inputs.telemetry is WARM
    assert inputs.board_event(api.BoardBooted("1.0", "B1", "BROWNOUT")) == [BoardBooted("1.0", "B1", "BROWNOUT")]
    assert inputs.board_event(api.Pulse(1, 2, 3)) == inputs.board_event(api.PulsesDone(4)) == []
    assert caplog.text == ""
    assert inputs.board_event(api.VsyncLost()) == []
    assert "no vertical sync" in caplog.text
    assert inputs.board_event(api.BoardLost("unplugged")) == [on.DeviceDown(Device.BOARD, "unplugged")]
    assert inputs.board_event(api.BoardLost("unplugged")) == [], "it is known"
    assert inputs.poll() == [], "there is no board to ask"


def test_temperatures_are_told_by_whoever_measures_them(desk: Desk, inputs: Inputs) -> None:
    for camera in desk.devices.cameras.values():
        assert camera.value is not None
        camera.value.live()
        assert camera.value.idle()
    desk.until(lambda: None not in (inputs.temperatures_c()[f"camera_{side}"] for side in ("left", "right")))
    unknown = {"projector": None, "case": None, "board": None}
    assert inputs.temperatures_c() == {**unknown, "camera_left": 30.5, "camera_right": 30.5}
    inputs.board_event(WARM)
    desk.devices.cameras["left"].lose("unplugged")
    measured = {"projector": 41.0, "case": 36.5, "board": 30.0}
    assert inputs.temperatures_c() == {**measured, "camera_left": None, "camera_right": 30.5}


def test_keys_come_before_the_board_and_a_flood_is_read_bit_by_bit(desk: Desk, inputs: Inputs) -> None:
    board = desk.devices.board.value
    desk.pad.waiting.append(api.KeyPress(api.Key.SCAN, 0))
    time.sleep(0.05)
    board._events += [BEAT] * 250  # type: ignore[union-attr]  # the script's
    events = inputs.poll()
    assert events[0] == KeyPress(api.Key.SCAN, 0)
    assert events[1:] == [BEAT] * 200
    assert inputs.poll() == [BEAT] * 50


def test_every_key_event_is_heard_and_a_pad_that_is_gone_is_told_once(desk: Desk, inputs: Inputs) -> None:
    pressed: list[api.KeyEvent] = [
        api.KeyPress(api.Key.UP, 0),
        api.KeyLongPress(api.Key.UP, 0),
        api.KeyStuck(api.Key.UP),
        api.KeyFreed(api.Key.UP),
    ]
    desk.pad.waiting += [*pressed, api.KeyRelease(api.Key.UP, 0, 0.1), api.KeysLost("unplugged")]
    told: list[on.Event] = []
    desk.until(lambda: told.extend(inputs.keys()) or len(told) >= 5)  # type: ignore[func-returns-value]
    assert told == [
        KeyPress(api.Key.UP, 0), KeyLongPress(api.Key.UP, 0), KeyStuck(api.Key.UP), KeyFreed(api.Key.UP),
        on.DeviceDown(Device.KEYS, "unplugged"),
    ]  # fmt: skip
    assert inputs.keys() == [], "nobody is there to ask"


@dataclass
class Running:
    desk: Desk
    service: Service
    stop: list[str] = field(default_factory=list)

    def press(self, key: api.Key, then: Callable[[], object], timeout_s: float = 10.0) -> None:
        self.desk.pad.waiting.append(api.KeyPress(key, 0))
        self.until(then, timeout_s)

    def until(self, then: Callable[[], object], timeout_s: float = 10.0) -> None:
        clock = self.desk.script.clock
        end_ns = clock.now_ns() + int(timeout_s * 1e9)
        while not then():
            assert clock.now_ns() < end_ns, self.service.machine.state
            self.service.run_cycle()

    def tell(self, *events: on.Event) -> None:
        """As if the process for points had said so, which cannot live here."""
        self.service.machine = run(self.service.machine, *events)

    def to(self, state: State) -> Callable[[], bool]:
        return lambda: self.service.machine.state is state


def running(desk: Desk, drawing: Drawing, clock: api.Clock | None = None) -> Running:
    rig, stop = desk.rig, list[str]()
    beginning = StartFacts(ChoicesFile(rig.storage.root, standard_choices(rig)), (), ())
    status = StatusFile(rig.storage.root, 7, "1.0")
    service = Service(
        rig, desk.parts, drawing, status, clock or desk.script.clock, beginning,
        lambda: stop[0] if stop else None,
    )  # fmt: skip
    return Running(desk, service, stop)


@pytest.fixture
def aiming(tmp_path: Path, drawing: Drawing) -> Iterator[Running]:
    with a_desk(tmp_path) as desk:
        one = running(desk, drawing)
        service = one.service
        service.machine = run(service.machine, *UPS, on.BootFinished(), *PARTS, on.StorageCounted(0, None, 100))
        one.until(one.to(State.AIM))
        yield one


def test_a_scan_from_the_key_to_the_gallery(aiming: Running, tmp_path: Path) -> None:
    aiming.press(api.Key.SCAN, aiming.to(State.CHECK))
    aiming.until(lambda: aiming.desk.parts.scans.folder(1))
    # Each process for points dies at once, the first ones before there is a frame: the diver hears of it all the same.
    aiming.until(aiming.to(State.REVIEW), 5.0)
    assert aiming.service.machine.scan is not None
    assert aiming.service.machine.scan.failed is not None
    aiming.press(api.Key.SCAN, aiming.to(State.AIM))
    (entry,) = Library(tmp_path).entries()
    assert Library(tmp_path).verify(entry.scan_id).ok
    aiming.press(api.Key.DOWN, lambda: aiming.desk.parts.gallery.shown)
    status = tmp_path / "run" / "status.json"
    aiming.until(lambda: json.loads(status.read_text())["gallery"])
    told = json.loads(status.read_text())
    assert (told["state"], told["gallery"]["scan"]) == ("GALLERY", entry.scan_id)


def test_a_scan_that_is_not_wanted_is_rejected(aiming: Running, tmp_path: Path) -> None:
    aiming.press(api.Key.SCAN, aiming.to(State.CHECK))
    aiming.until(lambda: aiming.desk.parts.scans.folder(1))
    aiming.tell(news.right(1), news.coarse(1, SUMMARY), news.full(1, SUMMARY))
    aiming.until(aiming.to(State.REVIEW))
    for _ in range(3):  # the alert is seen first
        aiming.press(api.Key.BACK, lambda: not aiming.desk.pad.waiting)
    aiming.desk.pad.waiting += [api.KeyPress(api.Key.BACK, 0), api.KeyLongPress(api.Key.BACK, 0)]
    aiming.until(aiming.to(State.AIM))
    aiming.until(lambda: not aiming.desk.parts.scans.busy)
    assert Library(tmp_path).entries() == []
    assert len(list((tmp_path / "rejected").iterdir())) == 1


def test_the_end_waits_for_the_disk_but_not_for_ever(tmp_path: Path, drawing: Drawing) -> None:
    gate = threading.Event()
    with a_desk(tmp_path) as desk:
        clock = SteppedClock(desk.script.clock.now_ns())
        one = running(desk, drawing, clock)
        desk.screen.there = False
        desk.devices.display.lose("unplugged")
        desk.parts.scans.submit(lambda: gate.wait(20.0))
        desk.parts.scans.count()
        one.stop.append("SIGTERM")
        begun_ns = clock.now_ns()
        ended = one.service.run(Watchdog(ServiceManager(None, None), tmp_path, "source"))
        lasted_s = (clock.now_ns() - begun_ns) / 1e9
        gate.set()
    assert not ended.power_off
    assert 30.0 <= lasted_s < 31.0
    assert json.loads((tmp_path / "run" / "status.json").read_text())["state"] == "SHUTDOWN"


def test_what_is_written_last_is_there_and_all_is_dark_when_the_service_has_ended(
    tmp_path: Path, drawing: Drawing
) -> None:
    written: list[str] = []
    with a_desk(tmp_path) as desk:
        one = running(desk, drawing)

        def slowly() -> None:
            desk.script.clock.sleep_s(0.1)
            written.append("choices")

        desk.parts.scans.submit(slowly)
        desk.parts.scans.count()
        one.stop.append("SIGTERM")
        one.service.run(Watchdog(ServiceManager(None, None), tmp_path, "source"))
        assert written == ["choices"]
        assert (tmp_path / "self-test").exists(), "the storage was tested at the start"
        assert not desk.parts.scans.busy
        told = [said for said in desk.said() if said.startswith(("show", "lasers"))]
        assert told[-2:] == [f"show {len(SEQUENCE)}", "lasers False False"]


@pytest.mark.parametrize("why", ["stopped: SIGTERM", "stopped by the diver"])
def test_a_sequence_that_plays_is_ended_by_the_system_and_by_the_diver(
    aiming: Running, why: str, caplog: pytest.LogCaptureFixture
) -> None:
    def meanwhile(events: list[api.BoardEvent]) -> list[api.BoardEvent]:
        if why.endswith("diver"):
            aiming.desk.pad.waiting += [api.KeyPress(api.Key.UP, 0), api.KeyPress(api.Key.BACK, 0)]
            aiming.desk.script.clock.sleep_s(0.1)  # until they were read
        else:
            aiming.stop.append("SIGTERM")
        return events

    aiming.desk.script.pulses = meanwhile
    aiming.press(api.Key.SCAN, lambda: "scan 1 of this start failed" in caplog.text)
    assert f"scan 1 of this start failed: CAPTURE_TIMEOUT: {why}" in caplog.text
    assert aiming.desk.script.shown == 0
