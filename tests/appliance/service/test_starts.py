"""The diver is told once that the program was started again, a scan recovered, or a new version taken back."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from appliance.machine.events import KeyPressed, Tick, Told
from appliance.machine.leading import alerts
from appliance.machine.states import boot
from appliance.machine.step import step
from appliance.scan.fault import FaultCode
from appliance.service.starts import installation, recovered, this_run
from appliance.storage.library import Library
from drivers.api import Key
from tests.appliance.storage.scenes import ORIGIN, frames, record


def told(runtime: Path | None, prefix: Path, *, ends_well: bool = True) -> list[FaultCode]:
    """What one run tells."""
    environment = {} if runtime is None else {"RUNTIME_DIRECTORY": str(runtime)}
    try:
        with this_run(environment, prefix) as news:
            if not ends_well:
                raise RuntimeError("as every error that ends the service")
    except RuntimeError:
        pass
    return [fault.code for fault in news]


def test_a_run_that_did_not_end_well_is_told_by_the_next_one_only(tmp_path: Path) -> None:
    source = tmp_path / "venv"
    assert told(tmp_path, source, ends_well=False) == []  # the first since power-on
    assert told(tmp_path, source) == [FaultCode.RESTARTED]
    assert told(tmp_path, source) == []


def test_at_a_desk_nothing_is_remembered(tmp_path: Path) -> None:
    assert told(None, tmp_path / "venv", ends_well=False) == told(None, tmp_path / "venv") == []


@pytest.mark.parametrize(
    ("outcome", "expected"),
    [
        ({"version": "new", "accepted": False, "reason": "it ended 2 times", "now": "old"}, [FaultCode.UPDATE_UNDONE]),
        ({"version": "old", "accepted": True, "reason": "self-test passed", "now": "old"}, []),
        ({"version": "new", "accepted": False, "reason": "it ended 2 times", "now": "older"}, []),
        ({"accepted": False}, []),
        ([], []),
    ],
)
def test_an_update_that_was_taken_back_is_told(tmp_path: Path, outcome: object, expected: list[FaultCode]) -> None:
    prefix = tmp_path / "versions" / "old"
    prefix.mkdir(parents=True)
    (tmp_path / "outcome.json").write_text(json.dumps(outcome))
    assert told(tmp_path, prefix) == expected
    assert installation(prefix) == "old"


def test_it_is_read_once_and_gone_with_the_next_key(tmp_path: Path) -> None:
    (tmp_path / "running").touch()
    with this_run({"RUNTIME_DIRECTORY": str(tmp_path)}, tmp_path) as news:
        machine, _ = step(boot(0), Told(news[0]))
    machine, _ = step(machine, Tick(1))
    assert [alert.headline for alert in alerts(machine)] == ["RESTARTED"]
    machine, _ = step(machine, KeyPressed(Key.UP))
    assert alerts(machine) == ()


def test_a_scan_that_was_cut_off_while_being_saved_is_told_once(tmp_path: Path) -> None:
    library = Library(tmp_path)
    library.prepare()
    begun = library.begin(frames(), record(), ORIGIN)  # whole on the disk, never published: here the power goes
    news = recovered(Library(tmp_path).recover().recovered)
    assert begun.scan_id in news[0].detail
    machine, _ = step(boot(0), Told(news[0]))
    assert [alert.headline for alert in alerts(machine)] == ["SCAN RECOVERED"]
    assert recovered(Library(tmp_path).recover().recovered) == (), "at the next start it is a scan like any other"
