"""Scans off an instrument: whole or not at all, gone on with where it broke off, nothing deleted or replaced at either end."""

from __future__ import annotations

import errno
import json
import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest

from appliance.cli import main
from appliance.store import archive, packed
from appliance.store import label as labels
from appliance.store import scan as stored
from appliance.store.atomic import LocalFileSystem, StorageError
from appliance.store.incomplete import IncompleteRecording
from appliance.store.library import Library, LibraryFolder
from appliance.store.manifest import Decision
from appliance.store.pull.pulling import PullResult, pull_from
from appliance.store.pull.source import (
    FolderSource,
    LinkLost,
    NotThere,
    PullError,
    RemoteEntry,
    Unreadable,
    is_linked,
    text_of,
)
from appliance.store.pull.taking import (
    ROOM_LEFT_BYTES,
    NotYet,
    PullOutcome,
    compare_present,
    draft_folder,
    find,
    present_bytes,
    take,
)
from appliance.store.scan import StoredScan
from tests.appliance.store.pull.instrument import FS, BreakingSource, content, instrument, opened, pulled, scan
from tests.appliance.store.scenes import ORIGIN, BadDisk, cloud, frames, record

MB = 1 << 20
TAKEN, ALREADY, LATER, FAILED, DIFFERS = (
    PullOutcome.TAKEN, PullOutcome.ALREADY, PullOutcome.LATER, PullOutcome.FAILED, PullOutcome.DIFFERS,
)  # fmt: skip


@pytest.fixture
def there(tmp_path: Path) -> Path:
    return instrument(tmp_path / "disk")


@pytest.fixture
def bare(tmp_path: Path) -> Path:
    """An instrument with nothing on its disk but an empty shelf."""
    root = tmp_path / "disk" / "lib" / "kingfisher"
    (root / "scans").mkdir(parents=True)
    return root


@pytest.fixture
def here(tmp_path: Path) -> Path:
    return tmp_path / "desk"


def reasons(done: PullResult, *outcomes: PullOutcome) -> dict[str, str]:
    return {one.what: one.reason for one in done.of(*outcomes)}


def test_everything_that_is_finished_comes_byte_for_byte_and_once(there: Path, here: Path) -> None:
    # None of them is a scan, finished or not.
    for name in (".trash", "notes"):
        (there / "scans" / name).mkdir()
    for name in (".000008", "000009"):
        (there / "scans" / name).write_text("")
    before, told = content(there.parent.parent), list[tuple[int, int]]()
    done = pulled(FolderSource(there), here, far=lambda *far: told.append(far[3:]))
    assert (done.is_complete, done.being_written) == (True, 1)
    theirs, ours = content(there), content(here)
    none = ("scans/.000008", "scans/000009")
    wanted = {path: data for path, data in theirs.items() if not path.startswith("rejected/") and path not in none}
    assert {path: ours.get(path) for path in wanted} == wanted
    assert ours.keys() - wanted.keys() == {"instrument/rig.toml"}
    assert all(entry.ok for entry in map(Library(here).verify, ("000001", "000002", "000003")))
    assert IncompleteRecording.load(here / "incomplete" / "000001").missing
    assert content(there.parent.parent) == before, "the instrument is as it was"
    came = {path: len(data) for path, data in ours.items() if not path.endswith(("manifest.json", "incomplete.json"))}
    assert done.taken_bytes == sum(came.values())
    of_scans = sum(length for path, length in came.items() if path.startswith(("scans/", "incomplete/")))
    assert told[-1] == (of_scans, of_scans), "manifests were read while looking"
    for number in ("1000000", "999999"):
        scan(there, number, 6)
    stood = {path: path.stat().st_mtime_ns for path in here.rglob("*") if path.is_file() and "run" not in path.parts}
    again = pulled(FolderSource(there), here)
    assert list(reasons(again, TAKEN)) == ["scans/999999", "scans/1000000"], "in the order of their numbers"
    assert {path: path.stat().st_mtime_ns for path in stood} == stood
    pulled(FolderSource(there), here, every=True)
    assert content(here / "rejected" / "000004") == content(there / "rejected" / "000004"), "when it is asked for"


def test_the_rig_file_and_small_files_are_taken_by_place_depth_and_kind(bare: Path, here: Path) -> None:
    for place in ("../../etc/kingfisher/rig.toml", "instrument/rig.toml", "../instrument/rig.toml"):
        (bare / place).parent.mkdir(parents=True)
        (bare / place).write_text(place)
        (bare / place).with_name("another").write_text("")
        desk = here.with_name(f"desk {place.count('/')}{len(place)}")
        done = pulled(FolderSource(bare), desk)
        assert (desk / "instrument" / "rig.toml").read_text() == place, "the instrument's own word comes first"
        assert (done.is_complete, done.taken_bytes) == (True, len(place))
    for folder in ("objects", "objects/1/2/3", "objects/1/2/3/4"):
        (bare / folder).mkdir(parents=True, exist_ok=True)
        for name in ("a.json", "b.html", "c.toml", "d.ply", "e.json.tmp"):
            (bare / folder / name).write_text("{}")
    assert pulled(FolderSource(bare), here).is_complete
    taken = {path for path in content(here) if path.startswith("objects/")}
    folders, names = ("objects", "objects/1/2/3"), ("a.json", "b.html", "c.toml")
    assert taken == {f"{folder}/{name}" for folder in folders for name in names}


def test_every_version_of_a_calibration_is_kept(there: Path, here: Path) -> None:
    pulled(FolderSource(there), here)
    current = "calibration/current.json"
    assert reasons(pulled(FolderSource(there), here), ALREADY)[current] == ""
    (there / current).write_text('{"of": "december"}\n')
    (copy,) = pulled(FolderSource(there), here).of(TAKEN)
    beside = here / "calibration" / copy.reason.removeprefix("as ")
    assert (here / current).read_text() == '{"of": "november"}\n'
    assert (beside.read_text(), copy.size_bytes) == ('{"of": "december"}\n', 19)
    assert not pulled(FolderSource(there), here).of(TAKEN)
    beside.write_text("something else")
    done = pulled(FolderSource(there), here)
    assert (list(reasons(done, DIFFERS)), done.is_complete) == ([current], False)


def test_what_was_worked_on_packed_or_put_away_at_the_desk_is_not_taken_again(there: Path, here: Path) -> None:
    stored.write_raw(FS, there / "scans" / "000007", "000007", frames(7), record(), ORIGIN)
    pulled(FolderSource(there), here)
    mine = here / "scans" / "000007"
    stored.finish_scan(FS, mine, StoredScan.manifest_of(mine), Decision.KEPT, record(), cloud(), None)
    assert pulled(FolderSource(there), here).is_complete
    Library(here).trash("000001")
    archived = here.with_name("archive")
    archive.make_scan_folders(FS, archived, LibraryFolder)
    for number in ("000002", "000003", "000007"):
        archive.pack_scan(FS, here / "scans" / number, archived / "scans" / number)
    Library(here).trash("000002")
    taken = reasons(pulled(FolderSource(there), archived), TAKEN)
    assert [what for what in taken if what.startswith("scans")] == ["scans/000001"]
    assert not pulled(FolderSource(there), here).of(TAKEN)
    assert (archived / "scans" / "000002" / f"frames_left.npy{packed.SUFFIX}").exists()


def test_what_differs_at_both_ends_is_named_and_left_alone(there: Path, here: Path) -> None:
    pulled(FolderSource(there), here)
    shutil.rmtree(here / "scans" / "000003")
    scan(here, "000003", 9)
    before = content(here / "scans" / "000003")
    labels.Label("the wreck").write(FS, here / "scans" / "000001")
    (here / "scans" / "000002" / labels.LABEL_FILE).unlink()
    done = pulled(FolderSource(there), here)
    said = reasons(done, DIFFERS)
    assert (set(said), done.is_complete) == ({"scans/000001", "scans/000003"}, False)
    assert "frames_left.npy" in said["scans/000003"]
    assert content(here / "scans" / "000003") == before
    assert labels.Label.read(here / "scans" / "000001").name == "the wreck"
    assert labels.Label.read(here / "scans" / "000002").name == "bollard 1", "one that is not here comes later, too"


def test_what_cannot_be_a_whole_recording_is_told_and_never_published(there: Path, here: Path) -> None:
    for number in ("000006", "000007", "000008", "000009"):
        scan(there, number)
    scans = there / "scans"
    (scans / "000006" / "manifest.json").unlink()
    (scans / "000007" / "manifest.json").write_text("{}")
    (scans / "000008" / "cloud.ply").unlink()
    (scans / "000009").rename(scans / "000010")
    path = scans / "000002" / "frames_right.npy"
    path.write_bytes(path.read_bytes()[:-1] + b"\0")
    done = pulled(FolderSource(there), here)
    said = reasons(done, FAILED)
    for number, words in (
        ("000002", "frames_right.npy: damaged"), ("000006", "no manifest"), ("000007", "manifest is not usable"), ("000008", "cloud.ply missing"),
        ("000010", "of scan 000009"),
    ):  # fmt: skip
        assert words in said.pop(f"scans/{number}")
    assert (said, done.is_complete) == ({}, False)
    assert sorted(path.name for path in (here / "scans").iterdir() if path.name[0] != ".") == ["000001", "000003"]
    (here / "scans" / "000001" / "cloud.ply").write_bytes(b"ply")
    assert "cloud.ply" in reasons(pulled(FolderSource(there), here), FAILED)["scans/000001"], "damaged here"
    (here / "scans" / "000001" / "manifest.json").unlink()
    assert "scans/000001" in reasons(pulled(FolderSource(there), here), DIFFERS)


Pieces = Callable[[str, Iterator[bytes]], Iterator[bytes]]


class Altered(FolderSource):
    """A folder of which a test changes the pieces of files or lists more; it notes how far small files were asked for."""

    def __init__(self, root: Path, pieces: Pieces = lambda _, found: found, more: Sequence[RemoteEntry] = ()) -> None:
        super().__init__(root)
        self._pieces, self._more, self.asked = pieces, more, list[int]()

    def listing(self, folder: str) -> list[RemoteEntry]:
        return [*super().listing(folder), *self._more]

    def read(self, path: str, start: int, end: int) -> Iterator[bytes]:
        self.asked.append(end)
        return self._pieces(path, super().read(path, start, end))


def flipped(wanted: str, times: int) -> Pieces:
    """Turn one bit of one file, the first ``times`` times that it is read."""
    left = iter(range(times))

    def pieces(path: str, found: Iterator[bytes]) -> Iterator[bytes]:
        mask = 1 if path == wanted and next(left, None) is not None else 0
        for data in found:
            yield bytes((data[0] ^ mask,)) + data[1:]
            mask = 0

    return pieces


def changed(folder: Path, gone: bool) -> Pieces:
    """A scan that gets a label, or goes, while its frames are read."""

    def pieces(path: str, found: Iterator[bytes]) -> Iterator[bytes]:
        yield from found
        if path.endswith(f"{folder.name}/frames_left.npy") and folder.exists():
            if gone:
                folder.rename(folder.with_name(f".{folder.name}"))
            else:
                labels.Label("bollard, and now a buoy").write(FS, folder)

    return pieces


@pytest.mark.parametrize("path", ["scans/000002/cloud.ply", "incomplete/000001/frames_left.npy"])
def test_a_flipped_bit_is_found_and_the_file_taken_anew_three_times_in_all(there: Path, here: Path, path: str) -> None:
    desk = here.with_name("again")
    assert pulled(Altered(there, flipped(path, 2)), desk).is_complete
    folder, _, name = path.rpartition("/")
    assert content(desk / folder) == content(there / folder)
    said = reasons(pulled(Altered(there, flipped(path, 3)), here), FAILED)
    assert (list(said), name in said[folder], "3 times" in said[folder]) == ([folder], True, True)


def test_a_scan_that_changes_meanwhile_comes_as_it_is_at_the_end_and_one_that_goes_later(
    there: Path, here: Path
) -> None:
    second, desk = there / "scans" / "000002", here.with_name("another")
    assert pulled(Altered(there, changed(second, gone=False)), here).is_complete
    assert content(here / "scans" / "000002") == content(second)
    done = pulled(Altered(there, changed(second, gone=True)), desk)
    assert list(reasons(done, LATER, FAILED)) == ["scans/000002"]
    assert [(desk / "scans" / number).exists() for number in ("000002", "000003")] == [False, True]


@pytest.mark.parametrize("lasts_bytes", [600, 7_000])
def test_a_link_that_breaks_in_a_file_is_gone_on_with_in_that_file(there: Path, here: Path, lasts_bytes: int) -> None:
    with pytest.raises(PullError, match="call again"):
        pulled(BreakingSource(there, lasts_bytes), here)
    half = {
        f"scans/{path.parent.name[1:7]}/{path.name}": path.stat().st_size for path in here.rglob("*.pulling/[a-z]*")
    }
    lengths = {path: (there / path).stat().st_size for path in half}
    on = BreakingSource(there, 10**9)
    assert pulled(on, here).is_complete
    assert content(here / "scans" / "000003") == content(there / "scans" / "000003")
    asked = {(path, start) for path, start in on.asked if 0 < start < (there / path).stat().st_size}
    assert asked == {(path, size) for path, size in half.items() if 0 < size < lengths[path]}, "no byte a second time"
    assert not list(here.rglob("*.pulling"))


def test_a_link_that_breaks_now_and_then_is_opened_again_and_one_over_which_nothing_comes_is_given_up(
    there: Path, here: Path
) -> None:
    links = iter(BreakingSource(there, 2_000) for _ in range(1000))
    waits: list[float] = []
    here.mkdir()
    done = pull_from(lambda: opened(next(links))(), here, FS, every=False, far=lambda *_: None, wait=waits.append)
    assert done.is_complete
    assert done.links == len(waits) + 1 > 3
    assert len(done.of(TAKEN)) == 7, "what came over an earlier link is not looked at again"
    assert set(waits) == {1.0}, "each link brought something: none waits longer than after the first break"
    waits.clear()
    with pytest.raises(PullError, match="6 attempts"):
        pull_from(opened(BreakingSource(there, 0)), here, FS, every=False, far=lambda *_: None, wait=waits.append)
    assert waits == [1.0, 2.0, 4.0, 8.0, 15.0]


def test_a_draft_is_gone_on_with_only_for_its_own_scan_and_made_durable(
    there: Path, here: Path, tmp_path: Path
) -> None:
    with pytest.raises(PullError):
        pulled(BreakingSource(there, 1_700), here)
    assert list(here.rglob("*.pulling/frames_left.npy"))
    other = tmp_path / "other"
    scan(other, "000001", 77)
    draft = draft_folder(here / "scans" / "000001")
    for name in ("incomplete.json", labels.LABEL_FILE, "notes.bin"):
        (draft / name).write_text("of another one")
    shutil.copy(other / "scans" / "000001" / "rig.toml", draft)  # written, and nobody had the time for its sync
    disk = BadDisk()
    assert pulled(FolderSource(other), here, disk).is_complete
    assert content(here / "scans" / "000001") == content(other / "scans" / "000001")
    assert "sync rig.toml" in disk.calls[: disk.calls.index(f"rename {draft.name} 000001")]


def test_the_disk_refuses_at_each_call_in_turn_and_no_half_scan_is_ever_seen(tmp_path: Path) -> None:
    only = tmp_path / "only"
    whole, disk = content(scan(only, "000001")), BadDisk()
    pulled(FolderSource(only), tmp_path / "counted", disk)
    published_at = disk.calls.index("rename .000001.pulling 000001")
    around = disk.calls[published_at - 1], disk.calls[published_at + 1]
    assert around == ("sync_folder .000001.pulling", "sync_folder scans")
    for k, call in enumerate(disk.calls):
        here = tmp_path / f"desk{k}"
        with pytest.raises(StorageError):
            pulled(FolderSource(only), here, BadDisk(k))
        published = here / "scans" / "000001"
        assert not published.exists() or content(published) == whole, call
        assert pulled(FolderSource(only), here).is_complete, call
        assert (content(published), draft_folder(published).exists()) == (whole, False), call


@pytest.mark.parametrize("lacking_bytes", [0, 1])
def test_a_recording_is_taken_in_pieces_and_only_where_it_leaves_some_room_on_the_disk(
    bare: Path, here: Path, lacking_bytes: int
) -> None:
    """Not to the last byte: whatever else is written there afterwards needs some."""
    folder = scan(bare, "000001")
    (folder / "notes.bin").write_bytes(bytes(5 * MB // 2))
    source, target, came = FolderSource(bare), here / "scans" / "000001", list[int]()
    found = find(source, "scans/000001")

    class Small(LocalFileSystem):
        def free_bytes(self, path: Path) -> int:
            return found.size_bytes + ROOM_LEFT_BYTES - lacking_bytes

    target.parent.mkdir(parents=True)
    assert present_bytes(found, target) == 0
    if lacking_bytes:
        with pytest.raises(StorageError, match="disk"):
            take(found, source, Small(), target, came.append)
        assert not target.exists()
        return
    take(found, source, Small(), target, came.append)
    assert content(target) == content(folder)
    assert [one for one in came if one >= MB // 2] == [MB, MB, MB // 2]
    assert sum(came) == found.size_bytes
    draft_folder(target).mkdir()
    (draft_folder(target) / "cloud.ply").write_bytes(b"123")
    assert present_bytes(found, target) == 3
    with pytest.raises(NotYet) as caught:
        compare_present(found, source, FS, target)
    assert caught.value.outcome is ALREADY


def test_a_folder_lists_and_reads_what_is_its_own(tmp_path: Path) -> None:
    data = bytes(k % 251 for k in range(5 * MB // 2))
    (tmp_path / "b").write_bytes(data)
    (tmp_path / "a").mkdir()
    (tmp_path / "c").symlink_to(tmp_path / "b")
    source = FolderSource(tmp_path)
    folder, file = source.listing("")
    assert (folder.name, folder.folder, file) == ("a", True, RemoteEntry("b", len(data), False))
    assert (is_linked(tmp_path, "c/x"), is_linked(tmp_path, "a/x")) == (True, False)
    assert [len(one) for one in source.read("b", 0, 1 << 40)] == [MB, MB, MB // 2]
    assert [len(one) for one in source.read("b", 0, 2 * MB)] == [MB, MB]
    assert b"".join(source.read("b", 7, MB + 9)) == data[7 : MB + 9]
    assert list(source.read("b", 7, 7)) == []


@pytest.mark.parametrize(
    ("codes", "error"),
    [
        ((errno.ENOENT, errno.ENOTDIR), NotThere),
        ((errno.EIO, errno.ENODEV, errno.ENXIO, errno.ESTALE, errno.ENOTCONN, errno.EHOSTDOWN, errno.ETIMEDOUT), LinkLost),
        ((errno.EACCES, errno.EISDIR, errno.ENAMETOOLONG), Unreadable),
    ],
)  # fmt: skip
def test_an_error_of_the_disk_is_gone_a_broken_link_or_unreadable(
    codes: tuple[int, ...], error: type[Exception], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for code in codes:

        def fail(_path: Path, code: int = code) -> Iterator[Path]:
            raise OSError(code, "why")

        monkeypatch.setattr(Path, "iterdir", fail)
        with pytest.raises(error, match=r"scans: why$"):
            FolderSource(tmp_path).listing("scans")


def test_a_small_file_is_read_up_to_its_limit_and_one_that_is_not_given_is_told(bare: Path, here: Path) -> None:
    name, source = "calibration/odd.json", Altered(bare)
    (bare / "calibration").mkdir()
    (bare / name).write_text("x" * 10)
    assert text_of(source, name, 10) == b"x" * 10
    with pytest.raises(Unreadable, match="9 bytes"):
        text_of(source, name, 9)
    pulled(source, here)
    assert source.asked == [11, 10, 50_000_001], "one byte more tells that it is longer"
    for error, outcome in ((NotThere("x"), LATER), (Unreadable("x"), FAILED)):

        def refused(_path: str, _found: Iterator[bytes], error: Exception = error) -> Iterator[bytes]:
            raise error

        done = pulled(Altered(bare, refused), here)
        assert (list(reasons(done, outcome)), done.is_complete) == ([name], False)


def test_names_that_lead_out_of_the_folder_are_not_followed(bare: Path, here: Path, tmp_path: Path) -> None:
    (bare / "calibration").mkdir()
    folder = scan(bare, "000001")
    names = ("../../evil", "/etc/evil", "..", "a/b", ".ssh", "-rf", "a\x1b[2J")
    odd = [RemoteEntry(f"{name}{end}", 5, end == "") for name in names for end in ("", ".json")]
    assert list(reasons(pulled(Altered(bare, more=odd), here, every=True), TAKEN)) == ["scans/000001"]
    assert set(content(here)) == {f"scans/000001/{name}" for name in content(folder)}
    assert not list(tmp_path.rglob("*evil*"))


@pytest.mark.parametrize("linked", ["calibration", "scans", "objects", "scans/000001"])
def test_a_linked_folder_on_a_strange_disk_does_not_lead_to_the_desks_own_files(
    linked: str, there: Path, here: Path, tmp_path: Path
) -> None:
    own = tmp_path / "own"
    own.mkdir()
    (own / "secret.json").write_text("{}", encoding="utf-8")
    shutil.rmtree(there / linked, ignore_errors=True)
    (there / linked).symlink_to(own)
    source = FolderSource(there)
    folder, _, name = linked.rpartition("/")
    assert name not in {one.name for one in source.listing(folder)}
    for ask in (lambda: source.listing(linked), lambda: list(source.read(f"{linked}/secret.json", 0, 10))):
        with pytest.raises(Unreadable, match="link"):
            ask()
    if linked != "scans":
        pulled(source, here)
    assert not list(tmp_path.glob("desk/**/secret*"))


def test_the_verb_takes_from_a_mounted_disk(there: Path, here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["archive", "pull", str(there.parent.parent), "--out", str(here)]
    assert main([*words, "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert (said["taken"], said["failed"], said["being_written"]) == (7, 0, 1)
    for k, root in enumerate((here, there)):
        scan(root, "000008", k)
    assert main(words) == 1
    assert "scans/000008  differs: " in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["./nowhere"], "scans"),
        (["--", "-oProxyCommand=touch evil"], "HOST"),
        (["instrument", "--identity", "missing"], "no such file"),
        (["instrument:0"], "1..65535"),
    ],
)
def test_what_cannot_be_meant_is_said_before_anything_is_made(
    words: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["archive", "pull", "--out", "desk", *words]) == 2
    assert said in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
