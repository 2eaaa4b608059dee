"""Who has no display reads the status file: always whole, always true, as docs/protocols/status.md says."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from appliance.calibrate.guide import LengthCheck, RecordingCheck, Refusal, Session, Step
from appliance.instrument.machine import events as on
from appliance.instrument.machine.states import (
    Answer,
    Calibrating,
    Device,
    Failure,
    FailureKind,
    Machine,
    OffQuestion,
    Task,
    boot,
)
from appliance.instrument.ranging.reach import Range, Reach
from appliance.instrument.service.status import StatusFile, describe
from appliance.measure.guidance import Guidance, Overlap
from tests.appliance.instrument.machine.walks import MISSING, aim, capturing, run


def told(machine: Machine, key: str) -> Any:
    return describe(machine, 1, "0.1.0")[key]


def test_it_says_what_the_diver_sees(tmp_path: Path) -> None:
    status = StatusFile(tmp_path, 4711, "0.1.0")
    machine = run(capturing(), on.CaptureFailed(1, MISSING), on.DeviceDown(Device.KEYS, "unplugged"))
    assert status.update(machine, 77, {"scan": "000003"})
    content = json.loads((tmp_path / "run" / "status.json").read_text(encoding="utf-8"))
    first = content["alerts"][0]
    assert (first["code"], first["headline"], first["action"]) == ("FRAME_MISSING", "INCOMPLETE 23/24", "REPEAT")
    assert (content["devices"]["keys"], content["devices"]["camera.left"]) == ("lost", "ok")
    assert (content["state"], content["scans"], content["last_scan"]) == ("AIM", 0, None)
    assert (content["pid"], content["version"]) == (4711, "0.1.0")
    assert (content["worker_pid"], content["gallery"]) == (77, {"scan": "000003"})
    assert told(boot(0), "devices") == {device.value: "unknown" for device in Device}, "neither there nor lost"


def test_it_is_written_on_changes_only_and_again_where_a_disk_refused(tmp_path: Path) -> None:
    status = StatusFile(tmp_path, 1, "0.1.0")
    (tmp_path / "run").write_text("in the way")
    assert not status.update(aim())
    (tmp_path / "run").unlink()
    assert status.update(aim())
    assert not status.update(run(aim(), on.Tick(10**9)))
    assert status.update(capturing())
    assert status.update(aim(), 77, {"scan": "000003"})
    assert not status.update(aim(), 77, {"scan": "000003"})
    assert status.update(aim(), 78, {"scan": "000003"})
    assert [path.name for path in status.path.parent.iterdir()] == ["status.json"]
    for _ in range(2):
        status.remove()
        assert not status.path.exists()


@pytest.mark.parametrize(
    ("changes", "key", "said"),
    [
        ({"range": Range(512.6, -7.4, 0.2512, 2), "reach": Reach.OK}, "range",
         {"distance_mm": 513, "tilt_deg": -7, "sigma_mm": 0.3, "dots": 2, "word": "OK"}),
        ({"range": Range(433.2, None, 1.04, 1), "reach": Reach.BACK}, "range",
         {"distance_mm": 433, "tilt_deg": None, "sigma_mm": 1.0, "dots": 1, "word": "BACK"}),
        ({"range": None}, "range", None),
        ({"guidance": Guidance(Overlap(0.2), (-0.8, 0.6))}, "guidance", {"words": "OVERLAP 20 %: GO BACK", "toward": [-0.8, 0.6]}),
        ({"guidance": Guidance(Overlap(0.5))}, "guidance", {"words": "OVERLAP 50 %: SCAN NOW", "toward": None}),
        ({}, "guidance", None),
        ({}, "question", None),
        *(({"off_question": OffQuestion(answer, 0)}, "question", {"answers": [one.value for one in Answer], "selected": answer.value})
          for answer in Answer),
    ],
)  # fmt: skip
def test_what_is_measured_and_asked_is_told(changes: dict[str, Any], key: str, said: object) -> None:
    assert told(replace(aim(), **changes), key) == said


M1, M2 = Step.M1, Step.M2
FITS = RecordingCheck(M1, None, 0.03, 900, "bar", "000001")
FEW = RecordingCheck(M2, Refusal.FEW_POINTS, 3.0, 3, "3 points")


@pytest.mark.parametrize(
    ("at", "said"),
    [
        (Calibrating(M1), (M1.value, False, None, "")),
        (Calibrating(M1, Task.EXAMINE), (M1.value, True, None, "")),
        (Calibrating(M1, latest=FITS), (M1.value, False, "FITS", "bar")),
        (Calibrating(M2, latest=FEW), (M2.value, False, "FEW_POINTS", "3 points")),
        (Calibrating(M2, latest=FITS, failed=Failure(FailureKind.DISK, "full")), (M2.value, False, "FAILED", "full")),
    ],
)
def test_a_calibration_under_way_tells_its_step_and_result(at: Calibrating, said: tuple[object, ...]) -> None:
    kept = "0001-2026-11-21.json"
    machine = replace(aim(), session=Session((FITS,), verified=LengthCheck(0.003, -0.0001, 0.00004, "ab"), kept=kept))
    assert told(machine, "calibration") is None, "while nobody calibrates"
    found = told(replace(machine, calibrating=at), "calibration")
    assert (found["step"], found["busy"], found["result"], found["detail"]) == said
    assert (found["done"], found["in_use"], found["kept"]) == ([M1.value, Step.VERIFY.value], False, kept)
    assert found["e_l_before_percent"] == pytest.approx(0.3)
    assert found["e_l_new_percent"] == pytest.approx(-0.01)
    unverified = told(replace(machine, session=Session(), calibrating=at), "calibration")
    assert (unverified["e_l_before_percent"], unverified["e_l_new_percent"]) == (None, None)
