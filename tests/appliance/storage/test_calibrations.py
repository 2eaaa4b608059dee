"""The calibration in use, the one of before and the session: what survives what."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from appliance.calibration.design import design_calibration
from appliance.calibration.file import Calibration, CalibrationError, encode, load
from appliance.calibration.guide import USED, AdjustmentSummary, RecordingCheck, Session, Step, Verified
from appliance.checksummed_file import checked_content, with_checksum
from appliance.storage.atomic import StorageError
from appliance.storage.calibrations import Calibrations, SessionError
from appliance.storage.filesystem import LocalFileSystem, WritableFile
from tests.support.calibrating import DESIGN
from tests.support.truth import WATER

OLD = design_calibration(DESIGN, "KF-TEST", 1600, 1200, WATER)
NEW = replace(OLD, method="bundle, spline", made_at="2026-11-21T10:00:00+00:00")
DAY = "2026-11-21"
VERIFIED = Verified(0.003, -0.0001, 0.00004, OLD.hash)


def solved(calibration: Calibration) -> AdjustmentSummary:
    return AdjustmentSummary(calibration.method, 0.031, ("0.026 px remain",), calibration.hash)


def recorded() -> Session:
    return Session(tuple(RecordingCheck(step, None, 0.03, 900, "bar", f"{k:06d}") for k, step in enumerate(USED, 1)))


def with_solution(store: Calibrations) -> Session:
    session = store.write(recorded())
    return store.write_solved(NEW, replace(session, solved=solved(NEW), verified=VERIFIED))


@pytest.fixture
def store(tmp_path: Path) -> Calibrations:
    made = Calibrations(tmp_path, "KF-TEST")
    made.folder.mkdir()
    made.current.write_bytes(encode(OLD) + b"\n")  # a blank more than this version writes
    return made


def test_a_session_is_the_same_after_a_new_start(store: Calibrations, tmp_path: Path) -> None:
    session = with_solution(store)
    assert Calibrations(tmp_path, "KF-TEST").session() == session
    assert session.next_step is Step.RESULT
    assert session.verified == VERIFIED


def test_a_check_says_nothing_about_a_calibration_that_came_later(store: Calibrations) -> None:
    checked = store.write(replace(Session(), verified=Verified(0.006, None, 0.0001, store.in_use)))
    assert checked.length_error == 0.006
    store.install(NEW, DAY)
    assert store.session().verified is None
    store.bring_back(None, DAY)
    assert store.session().length_error == 0.006, "that one was measured"


def test_the_old_file_comes_back_byte_for_byte(store: Calibrations) -> None:
    before = store.current.read_bytes()
    with_solution(store)
    used = store.use_solved(DAY)
    assert used.in_use
    assert load(store.current).hash == NEW.hash
    back = store.restore()
    assert not back.in_use
    assert store.current.read_bytes() == before
    assert store.use_solved(DAY).in_use, "and forth again"
    assert load(store.current).hash == NEW.hash
    assert len(list((store.folder / "kept").iterdir())) == 1, "the same file is kept once"


def test_an_installed_calibration_goes_and_comes_back(store: Calibrations) -> None:
    before = store.current.read_bytes()
    kept = store.install(NEW, DAY)
    assert kept is not None
    assert kept.read_bytes() == before
    assert load(store.current).hash == NEW.hash
    assert store.bring_back(None, DAY) == kept
    assert store.current.read_bytes() == before
    store.bring_back(None, DAY)
    assert load(store.current).hash == NEW.hash, "twice changes nothing"
    assert len(list((store.folder / "kept").iterdir())) == 2


def test_the_first_calibration_has_nothing_to_keep(tmp_path: Path) -> None:
    store = Calibrations(tmp_path, "KF-TEST")
    assert store.install(NEW, DAY) is None
    assert load(store.current).hash == NEW.hash
    with pytest.raises(SessionError, match="no other calibration is kept"):
        store.bring_back(None, DAY)


def test_a_kept_calibration_is_brought_back_by_name(store: Calibrations) -> None:
    kept = store.install(NEW, DAY)
    assert kept is not None
    newest = replace(NEW, made_at="2026-11-22T10:00:00+00:00")
    store.install(newest, "2026-11-22")
    store.bring_back(kept.name, "2026-11-22")
    assert load(store.current).hash == OLD.hash
    with pytest.raises(SessionError, match=r"no calibration 0009\.json is kept .*there: 0001-"):
        store.bring_back("0009.json", DAY)
    (store.folder / "kept" / "0003-bad.json").write_text("{")
    with pytest.raises(CalibrationError):
        store.bring_back(None, DAY)
    assert load(store.current).hash == OLD.hash, "a damaged file replaces nothing"


def test_two_calibrations_of_before_are_both_kept(store: Calibrations) -> None:
    with_solution(store)
    store.use_solved(DAY)
    store.begin()
    newer = replace(NEW, made_at="2026-12-01T10:00:00+00:00")
    store.write_solved(newer, replace(recorded(), solved=solved(newer)))
    assert store.use_solved("2026-12-01").kept == "0002-2026-12-01.json"
    assert sorted(p.name for p in (store.folder / "kept").iterdir()) == ["0001-2026-11-21.json", "0002-2026-12-01.json"]
    store.restore()
    assert load(store.current).hash == NEW.hash


def test_without_a_file_before_there_is_nothing_to_restore(store: Calibrations) -> None:
    store.current.unlink()
    with_solution(store)
    session = store.use_solved(DAY)
    assert session.in_use
    assert session.kept is None
    with pytest.raises(SessionError, match="kept"):
        store.restore()


def test_a_kept_file_that_was_damaged_is_not_put_in_use(store: Calibrations) -> None:
    with_solution(store)
    session = store.use_solved(DAY)
    assert session.kept is not None
    path = store.folder / "kept" / session.kept
    path.write_bytes(path.read_bytes().replace(b"design", b"desihn"))
    with pytest.raises(CalibrationError, match="checksum"):
        store.restore()
    assert load(store.current).hash == NEW.hash


@pytest.mark.parametrize("damage", [b"", b"{}", b"[1]", b"\xff\xfe", None])
def test_a_damaged_session_is_a_new_one_and_is_put_away_unharmed(store: Calibrations, damage: bytes | None) -> None:
    store.write(recorded())
    path = store.folder / "session" / "session.json"
    path.write_bytes(path.read_bytes().replace(b"0.03", b"0.04") if damage is None else damage)
    broken = path.read_bytes()
    assert store.session() == Session()
    assert store.begin() == Session()
    assert (store.folder / "sessions" / "0001" / "session.json").read_bytes() == broken


def test_a_session_of_another_instrument_is_not_continued(store: Calibrations, tmp_path: Path) -> None:
    store.write(recorded())
    assert Calibrations(tmp_path, "KF-OTHER").session() == Session()


class FailingDisk(LocalFileSystem):
    """Refuses the n-th call that changes anything, and all later ones: what power loss leaves."""

    def __init__(self, calls: int) -> None:
        self.left = calls

    def _take(self) -> None:
        self.left -= 1
        if self.left < 0:
            raise OSError(5, "gone")

    def make_folder(self, path: Path) -> None:
        self._take()
        super().make_folder(path)

    def create(self, path: Path) -> WritableFile:
        self._take()
        return super().create(path)

    def rename(self, source: Path, target: Path) -> None:
        self._take()
        super().rename(source, target)

    def sync_folder(self, path: Path) -> None:
        self._take()
        super().sync_folder(path)


def test_power_lost_at_any_moment_of_a_switch_leaves_the_old_or_the_new_and_a_way_back(tmp_path: Path) -> None:
    for calls in range(40):
        root = tmp_path / str(calls)
        store = Calibrations(root, "KF-TEST")
        store.folder.mkdir(parents=True)
        store.current.write_bytes(encode(OLD))
        with_solution(store)
        complete = True
        try:
            Calibrations(root, "KF-TEST", FailingDisk(calls)).use_solved(DAY)
        except StorageError:
            complete = False
        session = store.session()
        assert load(store.current).hash == (NEW.hash if session.in_use else OLD.hash)
        assert session.solved is not None
        if session.in_use:
            store.restore()
            assert store.current.read_bytes() == encode(OLD)
        if complete:
            return
    pytest.fail("the switch never went through")


def test_killed_while_a_step_is_entered_leaves_the_session_before_or_after(tmp_path: Path) -> None:
    """A process writes sessions without end and is killed; what lies there is always a whole one."""
    program = (
        "import sys\n"
        "from pathlib import Path\n"
        "from appliance.calibration.guide import Session, Step, RecordingCheck\n"
        "from appliance.storage.calibrations import Calibrations\n"
        "store = Calibrations(Path(sys.argv[1]), 'KF-TEST')\n"
        "k = 0\n"
        "while True:\n"
        "    k += 1\n"
        "    store.write(Session((RecordingCheck(Step.M1, None, 0.03, k, 'bar', f'{k:06d}'),)))\n"
        "    print(k, flush=True)\n"
    )
    store = Calibrations(tmp_path, "KF-TEST")
    for lines in (1, 7, 20):
        child = subprocess.Popen([sys.executable, "-c", program, str(tmp_path)], stdout=subprocess.PIPE, text=True)
        assert child.stdout is not None
        seen = 0
        for _ in range(lines):
            seen = int(child.stdout.readline())
        os.kill(child.pid, 9)
        rest = child.stdout.read().split()
        child.wait(10.0)
        last = int(rest[-1]) if rest else seen
        check = store.session().check(Step.M1)
        assert check is not None
        assert check.points in (last, last + 1)


def test_a_solved_calibration_lies_beside_the_report_that_speaks_of_it(store: Calibrations) -> None:
    session = store.write(recorded())
    store.write_solved(NEW, replace(session, solved=solved(NEW)), {"report.txt": b"0.026 px", "residuals.csv": b"1,2"})
    assert (store.folder / "session" / "report.txt").read_bytes() == b"0.026 px"
    assert (store.folder / "session" / "residuals.csv").read_bytes() == b"1,2"
    assert load(store.solved).hash == NEW.hash


# ------------------------------------------------------------------------------------------- names and what is not followed


def test_everything_of_a_calibration_lies_below_one_folder(tmp_path: Path) -> None:
    store = Calibrations(tmp_path, "KF-TEST")
    assert store.current == tmp_path / "calibration" / "current.json"
    assert store.air == tmp_path / "calibration" / "air.json"
    assert store.solved == tmp_path / "calibration" / "session" / "solved.json"
    assert store.in_use is None
    assert list(tmp_path.iterdir()) == [], "nothing is touched"
    store.install(NEW, DAY)
    assert store.in_use == NEW.hash


@pytest.mark.parametrize(
    "name", ["../current.json", "0001-2026-11-21.json/..", "current.json", "", "001-a.json", "0001-a/b.json"]
)
def test_a_session_names_no_file_outside_of_the_kept_ones(store: Calibrations, name: str) -> None:
    session = store.write(replace(recorded(), kept=name))
    assert session.kept is None
    assert store.kept(session) is None
    with pytest.raises(SessionError, match="no calibration of before is kept"):
        store.restore()


def test_the_calibration_of_before_is_read_from_where_it_is_kept(store: Calibrations) -> None:
    with_solution(store)
    session = store.use_solved(DAY)
    found = store.kept(session)
    assert found is not None
    assert found.hash == OLD.hash
    (store.folder / "kept" / str(session.kept)).write_text("{")
    assert store.kept(session) is None
    (store.folder / "kept" / str(session.kept)).unlink()
    assert store.session().kept is None, "a file that is gone is not kept"


def test_a_solution_whose_file_is_another_one_is_none(store: Calibrations) -> None:
    """Power was lost between the two files."""
    with_solution(store)
    store.solved.write_bytes(encode(OLD))
    session = store.session()
    assert (session.solved, session.verified) == (None, None)
    assert session.trials == recorded().trials
    with pytest.raises(SessionError, match="nothing is solved; solve first"):
        store.use_solved(DAY)


def test_without_a_solution_nothing_is_put_in_use(store: Calibrations) -> None:
    store.write(recorded())
    with pytest.raises(SessionError, match="nothing is solved"):
        store.use_solved(DAY)
    assert store.in_use == OLD.hash


def test_sessions_are_put_away_under_growing_numbers(store: Calibrations) -> None:
    assert store.begin() == Session(), "where there is none"
    (store.folder / "sessions").mkdir()
    (store.folder / "sessions" / "0041").mkdir()
    (store.folder / "sessions" / "notes").mkdir()
    for name in ("0042", "0043"):
        store.write(recorded())
        assert store.begin() == Session()
        assert (store.folder / "sessions" / name / "session.json").is_file()


def test_a_session_is_read_up_to_a_mebibyte_and_only_of_this_version(store: Calibrations) -> None:
    store.write(recorded())
    path = store.folder / "session" / "session.json"
    whole = path.read_bytes()
    for length, read in ((1024 * 1024, True), (1024 * 1024 + 1, False)):
        path.write_bytes(whole[:-2] + b" " * (length - len(whole)) + whole[-2:])
        assert (store.session() == recorded()) == read
    content = checked_content(whole, 1024 * 1024)
    for changed in ({"schema": 2}, {"rig_serial": "KF-OTHER"}):
        path.write_bytes(with_checksum({**content, **changed}))
        assert store.session() == Session()
    path.write_bytes(with_checksum({name: value for name, value in content.items() if name != "schema"}))
    assert store.session() == Session()


def test_that_a_calibration_is_in_use_is_never_written_down(store: Calibrations) -> None:
    with_solution(store)
    used = store.write(store.use_solved(DAY))
    assert used.in_use
    assert b'"in_use": false' in (store.folder / "session" / "session.json").read_bytes()


def test_what_was_checked_after_a_solution_stays_and_what_was_before_it_goes_with_another_calibration(
    store: Calibrations,
) -> None:
    with_solution(store)
    assert store.session().verified == VERIFIED
    store.install(replace(NEW, made_at="2026-12-24T10:00:00+00:00"), DAY)
    assert store.session().verified == replace(VERIFIED, before=None)
