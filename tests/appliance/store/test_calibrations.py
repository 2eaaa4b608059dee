"""The calibration in use, the one of before and the session: what survives what."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from appliance.calibrate.calibrations import Calibrations, SessionError
from appliance.calibrate.guide import USED, AdjustmentSummary, LengthCheck, RecordingCheck, Session, Step
from appliance.measure.calibration.design import design_calibration
from appliance.measure.calibration.file import Calibration, CalibrationError, encode_calibration
from appliance.store.instrument import load_calibration
from tests.appliance.store.scenes import padded
from tests.support.calibrating import DESIGN
from tests.support.sealing import opened, sealed
from tests.support.truth import WATER

OLD = design_calibration(DESIGN, "KF-TEST", 1600, 1200, WATER)
NEW = replace(OLD, method="bundle, spline", made_at="2026-11-21T10:00:00+00:00")
NEWER = replace(NEW, made_at="2026-12-01T10:00:00+00:00")
DAY, LATER = "2026-11-21", "2026-12-01"
VERIFIED = LengthCheck(0.003, -0.0001, 0.00004, OLD.hash)
TRIALS = tuple(RecordingCheck(step, None, 0.03, 900, "bar", f"{k:06d}") for k, step in enumerate(USED, 1))


def solved(calibration: Calibration) -> AdjustmentSummary:
    return AdjustmentSummary(calibration.method, 0.031, ("0.026 px remain",), calibration.hash)


def with_solution(store: Calibrations, of: Calibration = NEW) -> Session:
    session = store.write(Session(TRIALS))
    return store.write_solved(of, replace(session, solved=solved(of), verified=VERIFIED), {"report.txt": b"0.026 px"})


def kept_names(store: Calibrations) -> list[str]:
    return sorted(path.name for path in (store.folder / "kept").iterdir())


@pytest.fixture
def store(tmp_path: Path) -> Calibrations:
    made = Calibrations(tmp_path, "KF-TEST")
    made.folder.mkdir()
    made.current.write_bytes(encode_calibration(OLD) + b"\n")  # a blank more than this version writes
    return made


@pytest.fixture
def session_file(store: Calibrations) -> Path:
    store.write(Session(TRIALS))
    return store.folder / "session" / "session.json"


def test_a_session_is_the_same_after_a_new_start_and_of_this_instrument(store: Calibrations, tmp_path: Path) -> None:
    session = with_solution(store)
    assert Calibrations(tmp_path, "KF-TEST").session() == session
    assert (session.next_step, session.verified) == (Step.RESULT, VERIFIED)
    assert (store.folder / "session" / "report.txt").read_bytes() == b"0.026 px", "beside its solution"
    assert load_calibration(store.solved).hash == NEW.hash
    assert Calibrations(tmp_path, "KF-OTHER").session() == Session()


def test_a_session_is_read_whole_and_of_this_version_else_put_away(store: Calibrations, session_file: Path) -> None:
    whole = session_file.read_bytes()
    content = opened(whole)
    for data, read in (
        (padded(content, 1024 * 1024), True), (padded(content, 1024 * 1024 + 1), False), (sealed({**content, "schema": 2}), False),
        (sealed({name: value for name, value in content.items() if name != "schema"}), False),
        (sealed({**content, "rig_serial": "KF-OTHER"}), False), (whole.replace(b"0.03", b"0.04"), False),
        (b"", False), (b"{}", False), (b"[1]", False), (b"\xff\xfe", False),
    ):  # fmt: skip
        session_file.write_bytes(data)
        assert store.session() == (Session(TRIALS) if read else Session())
    assert store.begin() == Session()
    assert (store.folder / "sessions" / "0001" / "session.json").read_bytes() == b"\xff\xfe"


def test_sessions_are_put_away_under_growing_numbers(store: Calibrations) -> None:
    assert store.begin() == Session(), "where there is none"
    for name in ("0041", "notes"):
        (store.folder / "sessions" / name).mkdir(parents=True)
    for name in ("0042", "0043"):
        store.write(Session(TRIALS))
        assert store.begin() == Session()
        assert (store.folder / "sessions" / name / "session.json").is_file()


def test_a_solution_whose_file_is_another_one_is_none_and_is_not_put_in_use(store: Calibrations) -> None:
    """Power was lost between the two files."""
    with_solution(store)
    store.solved.write_bytes(encode_calibration(OLD))
    session = store.session()
    assert (session.solved, session.verified, session.trials) == (None, None, TRIALS)
    with pytest.raises(SessionError, match="no calibration is solved"):
        store.use_solved(DAY)
    assert store.in_use == OLD.hash


def test_a_session_names_no_file_outside_of_the_kept_ones(store: Calibrations) -> None:
    (store.folder / "kept").mkdir()
    (store.folder / "0001-a").mkdir()
    for name in (
        "../current.json", "0001-2026-11-21.json/..", "current.json", "", "001-a.json", "0001-a/b.json", "../../../../ESCAPED", "/etc/x", "..",
        "a\0b", "a\x1b[2J", ".hidden", "x" * 101, "٠٠٠١-2026-01-01.json",
    ):  # fmt: skip
        session = store.write(Session(TRIALS, kept=name))
        assert (session.kept, store.previous(session)) == (None, None), ascii(name)
        with pytest.raises(SessionError):
            store.restore()


def test_everything_of_a_calibration_lies_below_one_folder(tmp_path: Path) -> None:
    store = Calibrations(tmp_path, "KF-TEST")
    assert store.current == tmp_path / "calibration" / "current.json"
    assert store.air == tmp_path / "calibration" / "air.json"
    assert store.solved == tmp_path / "calibration" / "session" / "solved.json"
    assert (store.in_use, list(tmp_path.iterdir())) == (None, []), "nothing is touched"
    assert store.install(NEW, DAY) is None, "the first one has nothing to keep"
    assert store.in_use == load_calibration(store.current).hash == NEW.hash
    with pytest.raises(SessionError, match="no other calibration"):
        store.bring_back(None, DAY)


def test_the_old_file_comes_back_byte_for_byte_and_goes_again(store: Calibrations) -> None:
    before = store.current.read_bytes()
    with_solution(store)
    used = store.use_solved(DAY)
    assert (used.in_use, used.kept, store.in_use) == (True, "0001-2026-11-21.json", NEW.hash)
    found = store.previous(used)
    assert found is not None
    assert found.hash == OLD.hash
    store.write(used)
    assert b'"in_use": false' in (store.folder / "session" / "session.json").read_bytes(), "it is never written down"
    assert not store.restore().in_use
    assert store.current.read_bytes() == before
    assert store.use_solved(DAY).in_use
    assert kept_names(store) == ["0001-2026-11-21.json"], "the same file is kept once"
    store.begin()
    with_solution(store, NEWER)
    assert store.use_solved(LATER).kept == "0002-2026-12-01.json"
    store.restore()
    assert store.in_use == NEW.hash


def test_an_installed_calibration_goes_and_comes_back_also_by_name(store: Calibrations) -> None:
    before = store.current.read_bytes()
    kept = store.install(NEW, DAY)
    assert kept is not None
    assert kept.read_bytes() == before
    assert store.bring_back(None, DAY) == kept
    assert store.current.read_bytes() == before
    store.bring_back(None, DAY)
    assert store.in_use == NEW.hash, "twice changes nothing"
    assert len(kept_names(store)) == 2
    store.install(NEWER, LATER)
    store.bring_back(kept.name, LATER)
    assert store.in_use == OLD.hash
    with pytest.raises(SessionError, match=r"0009\.json.*0001-"):
        store.bring_back("0009.json", DAY)
    (store.folder / "kept" / "0009-bad.json").write_text("{")
    with pytest.raises(CalibrationError):
        store.bring_back(None, DAY)
    assert store.in_use == OLD.hash, "a damaged file replaces nothing"


def test_what_is_not_kept_any_more_or_damaged_is_not_put_in_use(store: Calibrations) -> None:
    with_solution(store)
    session = store.use_solved(DAY)
    path = store.folder / "kept" / str(session.kept)
    path.write_bytes(path.read_bytes().replace(b"design", b"desihn"))
    with pytest.raises(CalibrationError, match="checksum"):
        store.restore()
    assert (store.in_use, store.previous(session)) == (NEW.hash, None)
    path.unlink()
    assert store.session().kept is None
    store.begin()
    store.current.unlink()
    with_solution(store)
    session = store.use_solved(DAY)
    assert (session.in_use, session.kept) == (True, None), "there was none before"
    with pytest.raises(SessionError, match="kept"):
        store.restore()


def test_a_check_says_nothing_about_a_calibration_that_came_later(store: Calibrations) -> None:
    store.write(Session(verified=LengthCheck(0.006, None, 0.0001, store.in_use)))
    store.install(NEW, DAY)
    assert store.session().verified is None
    store.bring_back(None, DAY)
    assert store.session().length_error == 0.006, "that one was measured"
    with_solution(store)
    store.install(NEWER, DAY)
    assert store.session().verified == replace(VERIFIED, before=None), "what was checked after the solution stays"
