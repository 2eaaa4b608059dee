"""Who has no display reads the status file: always whole, always true, as docs/protocols/status.md says."""

from __future__ import annotations

import json
from pathlib import Path

from appliance.machine import events as on
from appliance.machine.states import Device
from appliance.storage.status import StatusFile
from tests.appliance.machine.walks import MISSING, aim, capturing, run


def test_it_says_what_the_diver_sees(tmp_path: Path) -> None:
    status = StatusFile(tmp_path, 4711, "0.1.0")
    machine = run(capturing(), on.CaptureFailed(1, MISSING), on.DeviceDown(Device.KEYS, "unplugged"))
    assert status.update(machine)
    content = json.loads((tmp_path / "run" / "status.json").read_text(encoding="utf-8"))
    assert content["state"] == "AIM"
    first = content["alerts"][0]
    assert (first["code"], first["headline"], first["action"]) == ("FRAME_MISSING", "INCOMPLETE 23/24", "REPEAT")
    assert content["devices"]["keys"] == "lost"
    assert content["devices"]["camera.left"] == "ok"
    assert (content["scans"], content["last_scan"], content["pid"], content["version"]) == (0, None, 4711, "0.1.0")


def test_it_is_written_on_changes_only_and_leaves_no_draft(tmp_path: Path) -> None:
    status = StatusFile(tmp_path, 1, "0.1.0")
    assert status.update(aim())
    assert not status.update(run(aim(), on.Tick(10**9)))
    assert status.update(capturing())
    assert [path.name for path in status.path.parent.iterdir()] == ["status.json"]
    status.remove()
    assert not status.path.exists()


def test_a_disk_that_refuses_is_tried_again(tmp_path: Path) -> None:
    (tmp_path / "run").write_text("in the way")
    status = StatusFile(tmp_path, 1, "0.1.0")
    assert not status.update(aim())
    (tmp_path / "run").unlink()
    assert status.update(aim())
