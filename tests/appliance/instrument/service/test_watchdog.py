"""Between programs: the service manager hears what is true, and the transfer is switched and heard by notes in folders."""

from __future__ import annotations

import json
import os
import socket
from dataclasses import replace
from pathlib import Path

import pytest

from appliance.instrument.machine import states
from appliance.instrument.machine.states import TRANSFER_UNKNOWN, Device, Machine, Part, Serving, State, Transfer, boot
from appliance.instrument.service.transfer import LOOK_NS, TransferSwitch
from appliance.instrument.service.watchdog import SELF_TEST_FILE, ServiceManager, Watchdog
from appliance.measure.fault import Fault, FaultCode


class Listener:
    def __init__(self, address: str) -> None:
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind(address)
        self.socket.setblocking(False)

    def heard(self) -> list[str]:
        """All datagrams since the last call, one text each."""
        said = []
        while True:
            try:
                said.append(self.socket.recv(4096).decode())
            except BlockingIOError:
                return said


def machine(now_s: float, state: State = State.AIM) -> Machine:
    return replace(boot(0), state=state, now_ns=int(now_s * 1e9))


def answered(at: Machine, *lost: Device, **parts: bool) -> Machine:
    results = {part: states.PartResult(part, parts.get(part.name.lower(), True)) for part in Part}
    up = frozenset(set(Device) - set(lost))
    gone = {device: Fault(FaultCode.CAMERA_LOST, "unplugged") for device in lost}
    return replace(at, up=up, lost=gone, parts=results)


@pytest.mark.parametrize("abstract", [False, True])
def test_it_says_ready_once_and_what_it_does(tmp_path: Path, abstract: bool) -> None:
    path = str(tmp_path / "notify")
    listener = Listener(f"\0{path}" if abstract else path)
    with ServiceManager(f"@{path}" if abstract else path, None) as manager:
        supervision = Watchdog(manager, tmp_path, "1.2-abc")
        assert listener.heard() == []  # nothing before a beat has ended
        supervision.report_cycle(machine(0.0, State.BOOT), worker_answers=True)
        assert listener.heard() == ["READY=1", "STATUS=BOOT"]
        supervision.report_cycle(machine(0.1), worker_answers=True)
        supervision.report_cycle(machine(0.2), worker_answers=True)
        assert listener.heard() == ["STATUS=AIM"]
        supervision.stopping()
        assert listener.heard() == ["STOPPING=1"]


class Signs:
    def __init__(self, folder: Path, watchdog_s: float) -> None:
        self.listener = Listener(str(folder / "notify"))
        self.now_s = 0.0
        manager = ServiceManager(str(folder / "notify"), watchdog_s)
        self.supervision = Watchdog(manager, folder, "", now_s=lambda: self.now_s)

    def during(self, beats: int, *, turning: bool = True, answers: bool = True) -> int:
        start_s, signs = self.now_s, 0
        for _ in range(beats):
            self.now_s += 0.05
            self.supervision.report_cycle(machine(self.now_s if turning else start_s), worker_answers=answers)
            signs += self.listener.heard().count("WATCHDOG=1")  # a socket holds ten
        return signs


def test_signs_of_life_come_four_times_in_the_managers_patience(tmp_path: Path) -> None:
    assert Signs(tmp_path, 20.0).during(600) == 6  # 30 s


def test_a_loop_that_does_not_get_on_or_lost_sight_of_its_worker_gives_no_sign(tmp_path: Path) -> None:
    signs = Signs(tmp_path, 2.0)
    assert signs.during(100) > 0
    signs.during(1, turning=False)
    for silent in ({"turning": False}, {"answers": False}):
        assert signs.during(100, **silent) == 0
        assert signs.during(100) > 0


def test_the_environment_is_taken_and_no_child_inherits_it(tmp_path: Path) -> None:
    listener = Listener(str(tmp_path / "notify"))
    environment = {
        "NOTIFY_SOCKET": str(tmp_path / "notify"),
        "WATCHDOG_USEC": "20000000",
        "WATCHDOG_PID": str(os.getpid()),
        "PATH": "/bin",
    }
    with ServiceManager.of(environment) as manager:
        assert environment == {"PATH": "/bin"}
        assert manager.watchdog_s == 20.0
        manager.ready()
    assert listener.heard() == ["READY=1"]


@pytest.mark.parametrize(
    "environment",
    [{}, {"WATCHDOG_USEC": "x"}, {"WATCHDOG_USEC": "0"}, {"WATCHDOG_USEC": "5000000", "WATCHDOG_PID": "1"}],
)
def test_a_watchdog_that_is_not_meant_is_none(environment: dict[str, str]) -> None:
    with ServiceManager.of(dict(environment)) as manager:
        assert manager.watchdog_s is None
        manager.alive()  # nobody to hear it


def test_a_manager_that_is_gone_or_does_not_listen_stops_nothing(tmp_path: Path) -> None:
    with ServiceManager(str(tmp_path / "nobody"), 1.0) as manager:
        manager.ready()
    deaf = Listener(str(tmp_path / "deaf"))
    with ServiceManager(str(tmp_path / "deaf"), 1.0) as manager:
        for _ in range(5000):  # more than the socket holds
            manager.alive()
    assert deaf.heard()


def test_the_self_test_is_written_down_with_the_version_it_was_of(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO", "kingfisher")
    supervision = Watchdog(ServiceManager(None, None), tmp_path, "0.2.0-3f2a9c1b")
    mark = tmp_path / SELF_TEST_FILE
    supervision.report_cycle(machine(0.0, State.BOOT), worker_answers=True)
    supervision.report_cycle(machine(0.1, State.SELF_TEST), worker_answers=True)
    assert not mark.exists()  # not everything has answered
    failing = answered(machine(0.2, State.SELF_TEST), Device.CAMERA_LEFT, calibration=False)
    supervision.report_cycle(failing, worker_answers=True)
    said = {"installation": "0.2.0-3f2a9c1b", "failed": ["calibration", "camera.left"]}
    assert json.loads(mark.read_text()) == said
    supervision.report_cycle(answered(machine(0.3)), worker_answers=True)  # the camera came, and so did the calibration
    assert json.loads(mark.read_text())["failed"] == []
    assert caplog.messages == ["self-test: failed: calibration, camera.left", "self-test: passed"]


TOLD = {"state": "on", "reason": "", "addresses": ["192.168.1.7", "fe80::1"], "keys": 2, "news": ""}


@pytest.fixture
def status(tmp_path: Path) -> Path:
    (tmp_path / "kingfisher").mkdir()
    (tmp_path / "kingfisher-transfer").mkdir()
    return tmp_path / "kingfisher-transfer" / "status.json"


def switch(status: Path) -> TransferSwitch:
    return TransferSwitch({"RUNTIME_DIRECTORY": f"{status.parents[1]}/kingfisher:/run/other"})


def test_the_note_is_what_the_unit_waits_for(status: Path) -> None:
    unit = (Path(__file__).parents[4] / "systemd" / "kingfisher-transfer.path").read_text()
    note = status.parents[1] / "kingfisher" / "transfer-on"
    assert "PathExists=/run/kingfisher/transfer-on\n" in unit
    switch(status).switch(to_on=True)
    assert note.exists()
    assert switch(status).is_on, "also for a service that was started again since power-on"
    for _ in range(2):
        switch(status).switch(to_on=False)
    assert not note.exists()


def test_what_is_told_is_heard_once_a_second_and_only_while_it_is_on(status: Path) -> None:
    one = switch(status)
    assert one.poll(0, is_on=False) == []
    assert one.poll(0, is_on=True) == [TRANSFER_UNKNOWN]
    status.write_text(json.dumps(TOLD))
    assert one.poll(LOOK_NS - 1, is_on=True) == []
    assert one.poll(LOOK_NS, is_on=True) == [Transfer(Serving.ON, "192.168.1.7", 2)]
    assert one.poll(2 * LOOK_NS, is_on=True) == [], "nothing new"
    assert one.poll(3 * LOOK_NS, is_on=False) == []
    assert one.poll(3 * LOOK_NS, is_on=True) != [], "switched on again, it is told anew"


@pytest.mark.parametrize(
    "wrong",
    [
        b"", b"[]", b"\xff", b"[" * 50_000,
        *(json.dumps(TOLD | {"keys": wrong}).encode() for wrong in (True, 1001, 1.0, -1)),
        json.dumps(TOLD | {"state": "open"}).encode(), json.dumps(TOLD | {"addresses": ["SHUT DOWN NOW"]}).encode(),
    ],
)  # fmt: skip
def test_what_cannot_be_understood_is_not_shown(status: Path, wrong: bytes) -> None:
    status.write_bytes(wrong)
    assert switch(status).poll(0, is_on=True) == [TRANSFER_UNKNOWN]


def test_an_address_that_the_screen_would_cut_is_not_shown(status: Path) -> None:
    widest, wider = "2001:db8:1111:2222:3333::1", "2001:db8:1111:2222:3333::12"
    for addresses, shown in (([wider], None), ([wider, widest], widest)):
        status.write_text(json.dumps(TOLD | {"addresses": addresses}))
        assert switch(status).poll(0, is_on=True) == [Transfer(Serving.ON, shown, 2)]


def test_at_a_desk_there_is_nothing_to_switch_and_a_note_that_cannot_be_written_ends_nothing(status: Path) -> None:
    (status.parents[1] / "kingfisher").rmdir()
    at_a_desk = TransferSwitch({})
    for one in (at_a_desk, switch(status)):
        one.switch(to_on=True)
        assert not one.is_on
    assert at_a_desk.poll(0, is_on=True) == [Transfer(Serving.FAILED)]
