"""Scans off an instrument: whole or not at all, gone on with where it broke off, nothing deleted or replaced at either end."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from appliance.cli import main
from appliance.offline.pull.pulling import HowFar
from appliance.offline.pull.source import FolderSource, PullError, RemoteEntry, Unreadable
from appliance.offline.pull.taking import ROOM_LEFT_BYTES, PullOutcome, draft_folder, find, take
from appliance.storage import archive, incomplete, packed
from appliance.storage import label as labels
from appliance.storage.atomic import StorageError
from appliance.storage.filesystem import LocalFileSystem
from appliance.storage.library import Library, LibraryFolder
from tests.appliance.offline.pull.instrument import (
    FS,
    BreakingSource,
    content,
    instrument,
    opened,
    pulled,
    scan,
)
from tests.appliance.storage.scenes import BadDisk


@pytest.fixture
def there(tmp_path: Path) -> Path:
    return instrument(tmp_path / "disk")


@pytest.fixture
def here(tmp_path: Path) -> Path:
    return tmp_path / "desk"


def test_everything_that_is_finished_comes_byte_for_byte(there: Path, here: Path) -> None:
    # Neither of them is a scan, finished or not.
    for name in (".trash", "notes"):
        (there / "scans" / name).mkdir()
    for name in (".000008", "000009"):
        (there / "scans" / name).write_text("")
    before = content(there.parent.parent)
    done = pulled(FolderSource(there), here)
    assert done.whole
    assert done.being_written == 1
    theirs, ours = content(there), content(here)
    wanted = {
        path: data
        for path, data in theirs.items()
        if not path.startswith("rejected/") and path not in ("scans/.000008", "scans/000009")
    }
    assert {path: ours.get(path) for path in wanted} == wanted
    assert ours.keys() - wanted.keys() == {"instrument/rig.toml"}
    assert (here / "instrument" / "rig.toml").read_text() == 'serial = "KF-0001"\n'
    assert all(entry.ok for entry in map(Library(here).verify, ("000001", "000002", "000003")))
    assert incomplete.load(here / "incomplete" / "000001").missing
    assert content(there.parent.parent) == before, "the instrument is as it was"
    manifests = ("manifest.json", "incomplete.json")
    assert done.taken_bytes == sum(len(data) for path, data in ours.items() if not path.endswith(manifests))


def test_rejected_scans_come_when_they_are_asked_for(there: Path, here: Path) -> None:
    pulled(FolderSource(there), here, every=True)
    assert content(here / "rejected" / "000004") == content(there / "rejected" / "000004")


def test_a_second_call_takes_only_what_is_new(there: Path, here: Path) -> None:
    pulled(FolderSource(there), here)
    scan(there, "000006", 6)
    stood = {path: path.stat().st_mtime_ns for path in here.rglob("*") if path.is_file() and "run" not in path.parts}
    done = pulled(FolderSource(there), here)
    assert [one.what for one in done.of(PullOutcome.TAKEN)] == ["scans/000006"]
    assert done.whole
    assert {path: path.stat().st_mtime_ns for path in stood} == stood


def test_a_file_that_an_ended_call_left_whole_is_made_durable_before_the_scan_has_its_name(
    there: Path, here: Path
) -> None:
    with pytest.raises(PullError):
        pulled(BreakingSource(there, 600), here)
    (draft,) = here.rglob("*.pulling")
    shutil.copy(there / "scans" / draft.name[1:7] / "rig.toml", draft)  # written, and nobody had the time for its sync
    disk = BadDisk()
    pulled(FolderSource(there), here, disk)
    published_at = disk.calls.index(f"rename {draft.name} {draft.name[1:7]}")
    assert "sync rig.toml" in disk.calls[:published_at]


@pytest.mark.parametrize("lasts_bytes", [100, 600, 2_000, 3_000, 7_000])
def test_a_link_that_breaks_in_a_file_is_gone_on_with_in_that_file(there: Path, here: Path, lasts_bytes: int) -> None:
    cut = BreakingSource(there, lasts_bytes)
    with pytest.raises(PullError, match="call again"):
        pulled(cut, here)
    half = {path: path.stat().st_size for path in here.rglob("*.pulling/[a-z]*")}
    on = BreakingSource(there, 10**9)
    done = pulled(on, here)
    assert done.whole
    assert content(here / "scans" / "000003") == content(there / "scans" / "000003")
    asked = {(path, start) for path, start in on.asked if 0 < start < (there / path).stat().st_size}
    wanted = {
        (f"scans/{path.parent.name[1:7]}/{path.name}", size)
        for path, size in half.items()
        if 0 < size < (there / "scans" / path.parent.name[1:7] / path.name).stat().st_size
    }
    assert asked == wanted, "no byte is taken a second time"
    assert not list(here.rglob("*.pulling"))


def test_a_link_that_breaks_now_and_then_is_opened_again_and_all_is_there(there: Path, here: Path) -> None:
    links = iter(BreakingSource(there, 2_000) for _ in range(1000))
    waits: list[float] = []
    here.mkdir()
    from appliance.offline.pull.pulling import pull

    def link() -> object:
        return opened(next(links))()

    done = pull(link, here, FS, every=False, far=lambda _: None, wait=waits.append)  # type: ignore[arg-type]
    assert done.whole
    assert done.links > 3
    assert len(waits) == done.links - 1
    assert len(done.of(PullOutcome.TAKEN)) == 7, "what came over an earlier link is not looked at again"
    assert set(waits) == {1.0}, "each link brought something: none waits longer than after the first break"


def test_a_link_over_which_nothing_comes_is_given_up(there: Path, here: Path) -> None:
    here.mkdir()
    waits: list[float] = []
    from appliance.offline.pull.pulling import pull

    with pytest.raises(PullError, match="the cable was pulled; tried 6 times"):
        pull(opened(BreakingSource(there, 0)), here, FS, every=False, far=lambda _: None, wait=waits.append)
    assert waits == [1.0, 2.0, 4.0, 8.0, 15.0]


class FlippingSource(FolderSource):
    """Turns one bit of one file, the first ``times`` times that it is read."""

    def __init__(self, root: Path, path: str, times: int) -> None:
        super().__init__(root)
        self._path, self._times = path, times

    def read(self, path: str, start: int, end: int) -> Iterator[bytes]:
        flips = path == self._path and self._times > 0
        self._times -= flips
        for k, data in enumerate(super().read(path, start, end)):
            yield bytes((data[0] ^ 1,)) + data[1:] if flips and k == 0 else data


@pytest.mark.parametrize(("name", "times"), [("frames_left.npy", 1), ("cloud.ply", 1), ("rig.toml", 2)])
def test_a_flipped_bit_is_found_and_the_file_taken_anew(there: Path, here: Path, name: str, times: int) -> None:
    done = pulled(FlippingSource(there, f"scans/000002/{name}", times), here)
    assert done.whole
    assert content(here / "scans" / "000002") == content(there / "scans" / "000002")


def test_a_scan_that_is_damaged_on_the_instrument_is_named_and_never_published(there: Path, here: Path) -> None:
    path = there / "scans" / "000002" / "frames_right.npy"
    data = bytearray(path.read_bytes())
    data[-1] ^= 1
    path.write_bytes(data)
    done = pulled(FolderSource(there), here)
    assert not done.whole
    (failed,) = done.of(PullOutcome.FAILED)
    assert failed.what == "scans/000002"
    assert "frames_right.npy: damaged" in failed.reason
    assert sorted(path.name for path in (here / "scans").iterdir() if path.name[0] != ".") == ["000001", "000003"]


def test_a_scan_that_differs_at_both_ends_is_named_and_left_alone(there: Path, here: Path) -> None:
    scan(here, "000002", 9)
    before = content(here / "scans" / "000002")
    done = pulled(FolderSource(there), here)
    (differs,) = done.of(PullOutcome.DIFFERS)
    assert differs.what == "scans/000002"
    assert "frames_left.npy" in differs.reason
    assert content(here / "scans" / "000002") == before
    assert not done.whole


def test_a_scan_that_was_worked_on_at_the_desk_is_the_same_scan(there: Path, here: Path) -> None:
    from appliance.storage import scan as stored
    from appliance.storage.manifest import Decision
    from tests.appliance.storage.scenes import ORIGIN, cloud, frames, record

    folder = there / "scans" / "000007"
    stored.write_raw(FS, folder, "000007", frames(7), record(), ORIGIN)
    pulled(FolderSource(there), here)
    mine = here / "scans" / "000007"
    stored.finish(FS, mine, stored.manifest_of(mine), Decision.KEPT, record(), cloud(), None)
    labels.write(FS, here / "scans" / "000001", labels.Label("bollard 0"))
    assert pulled(FolderSource(there), here).whole


def test_a_scan_that_was_packed_or_put_away_at_the_desk_is_not_taken_again(there: Path, here: Path) -> None:
    pulled(FolderSource(there), here)
    Library(here).trash("000001")
    packed_root = here.with_name("archive")
    archive.make_shelves(FS, packed_root, LibraryFolder)
    for number in ("000002", "000003"):
        archive.pack_scan(FS, here / "scans" / number, packed_root / "scans" / number)
    Library(here).trash("000002")
    done = pulled(FolderSource(there), packed_root)
    assert [one.what for one in done.of(PullOutcome.TAKEN) if one.what.startswith("scans")] == ["scans/000001"]
    assert not pulled(FolderSource(there), here).of(PullOutcome.TAKEN)
    assert (packed_root / "scans" / "000002" / f"frames_left.npy{packed.SUFFIX}").exists()


def test_another_name_at_both_ends_is_told_and_left_alone(there: Path, here: Path) -> None:
    pulled(FolderSource(there), here)
    labels.write(FS, here / "scans" / "000001", labels.Label("the wreck"))
    (here / "scans" / "000002" / labels.FILE_NAME).unlink()
    done = pulled(FolderSource(there), here)
    (differs,) = done.of(PullOutcome.DIFFERS)
    assert differs.what == "scans/000001"
    assert labels.read(here / "scans" / "000001").name == "the wreck"
    assert labels.read(here / "scans" / "000002").name == "bollard 1", "one that is not here comes later, too"


def test_every_version_of_a_calibration_is_kept(there: Path, here: Path) -> None:
    pulled(FolderSource(there), here)
    current = there / "calibration" / "current.json"
    current.write_text('{"of": "december"}\n')
    done = pulled(FolderSource(there), here)
    assert done.whole
    assert (here / "calibration" / "current.json").read_text() == '{"of": "november"}\n'
    assert sorted(path.read_text() for path in (here / "calibration").glob("current.*.json")) == [
        '{"of": "december"}\n'
    ]
    assert not pulled(FolderSource(there), here).of(PullOutcome.TAKEN)


class ChangingSource(FolderSource):
    """A scan that gets a cloud, or goes, while its frames are read."""

    def __init__(self, root: Path, gone: bool) -> None:
        super().__init__(root)
        self._changes = root / "scans" / "000002"
        self._gone = gone

    def read(self, path: str, start: int, end: int) -> Iterator[bytes]:
        yield from super().read(path, start, end)
        if path == "scans/000002/frames_left.npy" and self._changes.exists():
            if self._gone:
                self._changes.rename(self._changes.with_name(".000002"))
            else:
                labels.write(FS, self._changes, labels.Label("bollard, and now a buoy"))


def test_a_scan_that_changes_meanwhile_comes_as_it_is_at_the_end(there: Path, here: Path) -> None:
    assert pulled(ChangingSource(there, gone=False), here).whole
    assert content(here / "scans" / "000002") == content(there / "scans" / "000002")


def test_a_scan_that_is_taken_away_meanwhile_is_left_for_next_time(there: Path, here: Path) -> None:
    done = pulled(ChangingSource(there, gone=True), here)
    assert [one.what for one in done.of(PullOutcome.LATER, PullOutcome.FAILED)] == ["scans/000002"]
    assert not (here / "scans" / "000002").exists()
    assert (here / "scans" / "000003").exists()


def test_half_a_scan_of_another_instrument_is_not_gone_on_with(there: Path, here: Path, tmp_path: Path) -> None:
    with pytest.raises(PullError):
        pulled(BreakingSource(there, 1_700), here)
    assert list(here.rglob("*.pulling/frames_left.npy"))
    other = tmp_path / "other"
    scan(other, "000001", 77)
    assert pulled(FolderSource(other), here).whole
    assert content(here / "scans" / "000001") == content(other / "scans" / "000001")


def test_nothing_that_is_not_of_a_scan_stays_in_its_draft(there: Path, here: Path) -> None:
    draft = draft_folder(here / "scans" / "000001")
    draft.mkdir(parents=True)
    for name in ("incomplete.json", labels.FILE_NAME, "notes.bin"):
        (draft / name).write_text("of another one")
    assert pulled(FolderSource(there), here).whole
    assert content(here / "scans" / "000001") == content(there / "scans" / "000001")


def test_the_disk_refuses_at_each_call_in_turn_and_no_half_scan_is_ever_seen(there: Path, tmp_path: Path) -> None:
    only = tmp_path / "only"
    scan(only, "000001")
    calls = BadDisk()
    pulled(FolderSource(only), tmp_path / "counted", calls)
    published_at = calls.calls.index("rename .000001.pulling 000001")
    durable = {call.removeprefix("sync ") for call in calls.calls[:published_at] if call.startswith("sync ")}
    assert durable >= set(content(only / "scans" / "000001")) - {"manifest.json"}
    assert calls.calls[published_at - 1] == "sync_folder .000001.pulling"
    assert calls.calls[published_at + 1] == "sync_folder scans"
    for k in range(len(calls.calls)):
        here = tmp_path / f"desk{k}"
        with pytest.raises(StorageError):
            pulled(FolderSource(only), here, BadDisk(k))
        published = here / "scans" / "000001"
        assert not published.exists() or content(published) == content(only / "scans" / "000001"), calls.calls[k]
        assert pulled(FolderSource(only), here).whole, calls.calls[k]
        assert content(published) == content(only / "scans" / "000001"), calls.calls[k]
        assert not draft_folder(published).exists()


class HostileSource(FolderSource):
    """Names that lead elsewhere."""

    def listing(self, folder: str) -> list[RemoteEntry]:
        found = super().listing(folder)
        return [
            *found,
            *(RemoteEntry(name, 5, name == "scans") for name in ("../../evil", "/etc/evil", "a/b", ".ssh")),
        ]


def test_names_that_lead_out_of_the_folder_are_not_followed(there: Path, here: Path, tmp_path: Path) -> None:
    pulled(HostileSource(there), here)
    assert not list(tmp_path.rglob("*evil*"))
    assert not (here / "scans" / "000001" / ".ssh").exists()


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
        with pytest.raises(Unreadable, match="over a link"):
            ask()
    if linked != "scans":
        pulled(source, here)
    assert not list(tmp_path.glob("desk/**/secret*"))


def test_how_far_it_is_is_told_in_bytes_that_are_missing(there: Path, here: Path) -> None:
    told: list[HowFar] = []
    pulled(FolderSource(there), here, far=told.append)
    assert told[-1].done_bytes == told[-1].of_bytes > 0
    assert told[-1].of_bytes == sum(
        len(data)
        for path, data in content(here).items()
        if path.startswith(("scans/", "incomplete/")) and not path.endswith(("manifest.json", "incomplete.json"))
    ), "manifests were read while looking"


# ------------------------------------------------------------------------------------------- the verb


def test_the_verb_takes_from_a_mounted_disk(there: Path, here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    disk = str(there.parent.parent)
    assert main(["pull", disk, str(here), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert (said["taken"], said["failed"], said["being_written"]) == (7, 0, 1)
    scan(here, "000008", 1)
    scan(there, "000008", 2)
    assert main(["pull", disk, str(here)]) == 1
    out = capsys.readouterr().out
    assert "scans/000008  differs: " in out
    assert "1 still being written" in out


@pytest.mark.parametrize(
    ("host", "words"),
    [
        ("./nowhere", "no scans there"),
        ("-oProxyCommand=touch evil", "HOST"),
        ("instrument --identity missing", "no such file"),
    ],
)
def test_what_cannot_be_meant_is_said_before_anything_is_made(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], host: str, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    typed = (
        [host.split()[0], str(tmp_path / "desk"), *host.split()[1:]] if "--identity" in host else ["--", host, "desk"]
    )
    assert main(["pull", *typed]) == 2
    assert words in capsys.readouterr().err
    assert os.listdir(tmp_path) == []  # noqa: PTH208


@pytest.mark.parametrize("lacking_bytes", [0, 1])
def test_a_recording_is_taken_only_where_it_leaves_some_room_on_the_disk(
    there: Path, here: Path, lacking_bytes: int
) -> None:
    """Not to the last byte: whatever else is written there afterwards needs some."""
    wanted = find(FolderSource(there), "scans/000001")

    class Small(LocalFileSystem):
        def free_bytes(self, path: Path) -> int:
            del path
            return wanted.size_bytes + ROOM_LEFT_BYTES - lacking_bytes

    target = here / "scans" / "000001"
    target.parent.mkdir(parents=True)
    if lacking_bytes:
        with pytest.raises(StorageError, match=r"the disk lacks 0\.0 MB"):
            take(wanted, FolderSource(there), Small(), target, lambda _: None)
    else:
        take(wanted, FolderSource(there), Small(), target, lambda _: None)
        assert content(target) == content(there / "scans" / "000001")
    assert target.exists() is not bool(lacking_bytes)


def test_scans_beyond_six_digits_are_taken_in_the_order_of_their_numbers(there: Path, here: Path) -> None:
    for number in ("1000000", "999999"):
        scan(there, number, 7)
    seen: list[str] = []
    done = pulled(FolderSource(there), here, far=lambda far: seen.append(far.doing))
    taken = [one for one in dict.fromkeys(seen) if one.startswith("taking scans/")]
    assert taken[-2:] == ["taking scans/999999", "taking scans/1000000"]
    assert [one.what for one in done.of(PullOutcome.TAKEN)][-2:] == ["scans/999999", "scans/1000000"]
