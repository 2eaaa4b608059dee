"""The heartbeat on devices that follow a script: what the diver does reaches every part, and its end waits for the disk."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import moderngl
import pytest

from appliance.instrument import standard_choices
from appliance.machine import events as on
from appliance.machine.states import State
from appliance.machine.words import Language
from appliance.screens.unchanged import FrugalPainter
from appliance.service.loop import Service
from appliance.service.notify import ServiceManager
from appliance.service.parts import Beginning
from appliance.service.recording import DrawnPatterns
from appliance.service.watchdog import Watchdog
from appliance.storage.choices import ChoicesFile
from appliance.storage.library import Library
from appliance.storage.status import StatusFile
from drivers.api import BoardEvent, Clock, Key, KeyLongPress, KeyPress
from drivers.output.gl import open_gl
from tests.appliance.capture.test_course_of_a_scan import SEQUENCE
from tests.appliance.machine.walks import PARTS, SUMMARY, UPS, run
from tests.appliance.service.scripted import Desk, a_desk, small_rig
from tests.drivers.clock import SteppedClock


@dataclass
class Drawing:
    """GL and what draws by it, once for all tests here."""

    gl: moderngl.Context
    patterns: DrawnPatterns
    painter: FrugalPainter


@pytest.fixture(scope="module")
def drawing(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Drawing]:
    rig = small_rig(tmp_path_factory.mktemp("rig"))
    size_px = rig.display.width_px, rig.display.height_px
    with open_gl() as gl, FrugalPainter(gl, size_px, Language.ENGLISH) as painter:
        yield Drawing(gl, DrawnPatterns(gl, rig, 64, None), painter)


@dataclass
class Running:
    desk: Desk
    service: Service
    stop: list[str] = field(default_factory=list)

    def press(self, key: Key, then: Callable[[], object], timeout_s: float = 10.0) -> None:
        self.desk.pad.waiting.append(KeyPress(key, 0))
        self.until(then, timeout_s)

    def until(self, then: Callable[[], object], timeout_s: float = 10.0) -> None:
        clock = self.desk.script.clock
        end_ns = clock.now_ns() + int(timeout_s * 1e9)
        while not then():
            assert clock.now_ns() < end_ns, self.service.machine.state
            self.service.beat()

    def tell(self, *events: on.Event) -> None:
        """As if the process for points had said so, which cannot live here."""
        self.service.machine = run(self.service.machine, *events)

    def to(self, state: State) -> Callable[[], bool]:
        return lambda: self.service.machine.state is state


def running(desk: Desk, drawing: Drawing, clock: Clock | None = None) -> Running:
    rig, stop = desk.rig, list[str]()
    beginning = Beginning(ChoicesFile(rig.storage.root, standard_choices(rig)), (), ())
    status = StatusFile(rig.storage.root, 7, "1.0")
    service = Service(
        rig, desk.parts, drawing.patterns, drawing.painter, status, clock or desk.script.clock, beginning,
        lambda: stop[0] if stop else None,
    )  # fmt: skip
    return Running(desk, service, stop)


@pytest.fixture
def aiming(tmp_path: Path, drawing: Drawing) -> Iterator[Running]:
    """The self-test is over, and the diver aims."""
    with a_desk(tmp_path) as desk:
        one = running(desk, drawing)
        service = one.service
        service.machine = run(service.machine, *UPS, on.BootFinished(), *PARTS, on.StorageCounted(0, None, 100))
        one.until(one.to(State.AIM))
        yield one


def test_a_scan_from_the_key_to_the_gallery(aiming: Running, tmp_path: Path) -> None:
    aiming.press(Key.SCAN, aiming.to(State.CHECK))
    aiming.until(lambda: aiming.desk.parts.scans.folder(1))
    # Each process for points dies at once, the first ones before there is a frame: the diver hears of it all the same.
    aiming.until(aiming.to(State.REVIEW), 5.0)
    assert aiming.service.machine.scan is not None
    assert aiming.service.machine.scan.failed is not None
    aiming.press(Key.SCAN, aiming.to(State.AIM))
    (entry,) = Library(tmp_path).entries()
    assert Library(tmp_path).verify(entry.scan_id).ok
    aiming.press(Key.DOWN, lambda: aiming.desk.parts.gallery.shown)
    status = tmp_path / "run" / "status.json"
    aiming.until(lambda: json.loads(status.read_text())["gallery"])
    told = json.loads(status.read_text())
    assert (told["state"], told["gallery"]["scan"]) == ("GALLERY", entry.scan_id)


def test_a_scan_that_is_not_wanted_is_rejected(aiming: Running, tmp_path: Path) -> None:
    aiming.press(Key.SCAN, aiming.to(State.CHECK))
    aiming.until(lambda: aiming.desk.parts.scans.folder(1))
    aiming.tell(on.PatternsRight(1), on.CoarseReady(1, SUMMARY), on.FullReady(1, SUMMARY))
    aiming.until(aiming.to(State.REVIEW))
    for _ in range(3):  # the alert is seen first
        aiming.press(Key.BACK, lambda: not aiming.desk.pad.waiting)
    aiming.desk.pad.waiting += [KeyPress(Key.BACK, 0), KeyLongPress(Key.BACK, 0)]
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
    def meanwhile(events: list[BoardEvent]) -> list[BoardEvent]:
        if why.endswith("diver"):
            aiming.desk.pad.waiting += [KeyPress(Key.UP, 0), KeyPress(Key.BACK, 0)]
            aiming.desk.script.clock.sleep_s(0.1)  # until they were read
        else:
            aiming.stop.append("SIGTERM")
        return events

    aiming.desk.script.pulses = meanwhile
    aiming.press(Key.SCAN, lambda: "scan 1 of this start failed" in caplog.text)
    assert f"scan 1 of this start failed: CAPTURE_TIMEOUT: {why}" in caplog.text
    assert aiming.desk.script.shown == 0
