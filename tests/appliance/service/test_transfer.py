"""The switch of the transfer: a note in the service's own folder, and whatever the other program may write in return."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from appliance.machine import events as on
from appliance.machine.transfer import NOT_TOLD, Serving, Transfer
from appliance.service.transfer import LOOK_NS, TransferSwitch

TOLD = {"state": "on", "reason": "", "addresses": ["192.168.1.7", "fe80::1"], "keys": 2, "news": ""}


@pytest.fixture
def status(tmp_path: Path) -> Path:
    (tmp_path / "kingfisher").mkdir()
    (tmp_path / "kingfisher-transfer").mkdir()
    return tmp_path / "kingfisher-transfer" / "status.json"


def switch(status: Path) -> TransferSwitch:
    return TransferSwitch({"RUNTIME_DIRECTORY": f"{status.parents[1]}/kingfisher:/run/other"})


def test_the_note_is_what_the_unit_waits_for(status: Path) -> None:
    unit = (Path(__file__).parents[3] / "systemd" / "kingfisher-transfer.path").read_text()
    note = status.parents[1] / "kingfisher" / "transfer-on"
    assert "PathExists=/run/kingfisher/transfer-on\n" in unit
    switch(status).switch(to_on=True)
    assert note.exists()
    assert switch(status).wanted, "also for a service that was started again since power-on"
    for _ in range(2):
        switch(status).switch(to_on=False)
    assert not note.exists()


def test_what_is_told_is_heard_once_a_second_and_only_while_it_is_on(status: Path) -> None:
    one = switch(status)
    assert one.poll(0, wanted=False) == []
    assert one.poll(0, wanted=True) == [on.TransferTold(NOT_TOLD)]
    status.write_text(json.dumps(TOLD))
    assert one.poll(LOOK_NS - 1, wanted=True) == []
    assert one.poll(LOOK_NS, wanted=True) == [on.TransferTold(Transfer(Serving.ON, "192.168.1.7", 2))]
    assert one.poll(2 * LOOK_NS, wanted=True) == [], "nothing new"
    assert one.poll(3 * LOOK_NS, wanted=False) == []
    assert one.poll(3 * LOOK_NS, wanted=True) != [], "switched on again, it is told anew"


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
    assert switch(status).poll(0, wanted=True) == [on.TransferTold(NOT_TOLD)]


def test_an_address_that_the_screen_would_cut_is_not_shown(status: Path) -> None:
    widest, wider = "2001:db8:1111:2222:3333::1", "2001:db8:1111:2222:3333::12"
    for addresses, shown in (([wider], None), ([wider, widest], widest)):
        status.write_text(json.dumps(TOLD | {"addresses": addresses}))
        assert switch(status).poll(0, wanted=True) == [on.TransferTold(Transfer(Serving.ON, shown, 2))]


def test_at_a_desk_there_is_nothing_to_switch_and_a_note_that_cannot_be_written_ends_nothing(status: Path) -> None:
    (status.parents[1] / "kingfisher").rmdir()
    at_a_desk = TransferSwitch({})
    for one in (at_a_desk, switch(status)):
        one.switch(to_on=True)
        assert not one.wanted
    assert at_a_desk.poll(0, wanted=True) == [on.TransferTold(Transfer(Serving.FAILED))]
