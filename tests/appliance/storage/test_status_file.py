"""Who has no display reads the status file: always whole, always true, as docs/protocols/status.md says."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from appliance.calibration.guide import RecordingCheck, Refusal, Session, Step, Verified
from appliance.machine import events as on
from appliance.machine.failure import Failure, FailureKind
from appliance.machine.states import Answer, Calibrating, Device, OffQuestion, Task, boot
from appliance.ranging.reach import Range, Reach
from appliance.scan.guidance import Guidance
from appliance.scan.overlap import Overlap
from appliance.storage.status import StatusFile, describe
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


def test_a_distance_is_told_in_whole_millimetres_and_degrees_with_its_word(tmp_path: Path) -> None:
    machine = replace(aim(), range=Range(512.6, -7.4, 0.2512, 2), reach=Reach.OK)
    told = describe(machine, 1, "0.1.0")["range"]
    assert told == {"distance_mm": 513, "tilt_deg": -7, "sigma_mm": 0.3, "dots": 2, "word": "OK"}
    alone = describe(replace(machine, range=Range(433.2, None, 1.04, 1), reach=Reach.BACK), 1, "0.1.0")["range"]
    assert alone == {"distance_mm": 433, "tilt_deg": None, "sigma_mm": 1.0, "dots": 1, "word": "BACK"}
    assert describe(replace(machine, range=None), 1, "0.1.0")["range"] is None


def test_where_to_aim_is_told_in_words_with_the_arrows_direction() -> None:
    machine = replace(aim(), guidance=Guidance(Overlap(0.2), (-0.8, 0.6)))
    assert describe(machine, 1, "0.1.0")["guidance"] == {"words": "OVERLAP 20 %: GO BACK", "toward": [-0.8, 0.6]}
    there = replace(machine, guidance=Guidance(Overlap(0.5)))
    assert describe(there, 1, "0.1.0")["guidance"] == {"words": "OVERLAP 50 %: SCAN NOW", "toward": None}
    assert describe(aim(), 1, "0.1.0")["guidance"] is None


def test_what_is_asked_before_switching_off_and_the_answer_that_is_selected(tmp_path: Path) -> None:
    machine = aim()
    assert describe(machine, 1, "0.1.0")["question"] is None
    for answer in Answer:
        asked = describe(replace(machine, off_question=OffQuestion(answer, 0)), 1, "0.1.0")["question"]
        assert asked == {"answers": [one.value for one in Answer], "selected": answer.value}


def test_a_calibration_under_way_tells_its_step_and_what_came_of_the_latest_recording() -> None:
    session = Session(
        (RecordingCheck(Step.M1, None, 0.03, 900, "bar", "000001"),),
        verified=Verified(0.003, -0.0001, 0.00004, "ab"),
        kept="0001-2026-11-21.json",
    )
    machine = replace(aim(), session=session)
    assert describe(machine, 1, "0.1.0")["calibration"] is None, "while nobody calibrates"

    def told(at: Calibrating) -> dict[str, object]:
        found = describe(replace(machine, calibrating=at), 1, "0.1.0")["calibration"]
        assert isinstance(found, dict)
        return found

    none = told(Calibrating(Step.M1))
    assert (none["step"], none["busy"], none["result"], none["detail"]) == (Step.M1.value, False, None, "")
    assert none["done"] == [Step.M1.value, Step.VERIFY.value]
    assert none["e_l_before_percent"] == pytest.approx(0.3)
    assert none["e_l_new_percent"] == pytest.approx(-0.01)
    assert (none["in_use"], none["kept"]) == (False, "0001-2026-11-21.json")
    assert told(Calibrating(Step.M1, Task.EXAMINE))["busy"] is True
    fits = told(Calibrating(Step.M1, latest=session.trials[0]))
    assert (fits["result"], fits["detail"]) == ("FITS", "bar")
    few = RecordingCheck(Step.M2, Refusal.FEW_POINTS, 3.0, 3, "3 points")
    refused = told(Calibrating(Step.M2, latest=few))
    assert (refused["result"], refused["detail"]) == ("FEW_POINTS", "3 points")
    failed = told(Calibrating(Step.M2, latest=session.trials[0], failed=Failure(FailureKind.DISK, "it is full")))
    assert (failed["result"], failed["detail"]) == ("FAILED", "it is full")
    unverified = describe(replace(machine, session=Session(), calibrating=Calibrating(Step.M1)), 1, "0.1.0")[
        "calibration"
    ]
    assert (unverified["e_l_before_percent"], unverified["e_l_new_percent"]) == (None, None)


def test_a_device_that_was_never_tried_is_neither_there_nor_lost() -> None:
    devices = describe(boot(0), 1, "0.1.0")["devices"]
    assert set(devices) == {device.value for device in Device}
    assert set(devices.values()) == {"unknown"}


def test_the_worker_and_the_gallery_are_told_and_a_status_taken_away_twice_is_no_error(tmp_path: Path) -> None:
    status = StatusFile(tmp_path, 1, "0.1.0")
    assert status.update(aim(), 77, {"scan": "000003"})
    assert not status.update(aim(), 77, {"scan": "000003"})
    content = json.loads(status.path.read_text(encoding="utf-8"))
    assert (content["worker_pid"], content["gallery"]) == (77, {"scan": "000003"})
    assert status.update(aim(), 78, {"scan": "000003"})
    status.remove()
    status.remove()
