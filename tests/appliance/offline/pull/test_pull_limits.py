"""What is taken of an instrument and what is not: each limit from both sides, each place, and each kind of failure."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from pathlib import Path

import pytest

from appliance.offline.pull.pulling import Pulled
from appliance.offline.pull.source import (
    FolderSource,
    LinkLost,
    NotThere,
    RemoteEntry,
    Unreadable,
    is_linked,
    text_of,
)
from appliance.offline.pull.taking import (
    NotYet,
    PullOutcome,
    already_here_bytes,
    draft_folder,
    find,
    present,
    take,
)
from tests.appliance.offline.pull.instrument import FS, content, instrument, pulled, scan
from tests.appliance.offline.pull.test_pulling import FlippingSource

MB = 1 << 20


@pytest.fixture
def there(tmp_path: Path) -> Path:
    """An instrument with nothing on its disk but an empty shelf."""
    root = tmp_path / "disk" / "lib" / "kingfisher"
    (root / "scans").mkdir(parents=True)
    return root


@pytest.fixture
def here(tmp_path: Path) -> Path:
    return tmp_path / "desk"


def reasons(done: Pulled, outcome: PullOutcome) -> dict[str, str]:
    return {one.what: one.reason for one in done.of(outcome)}


# -------------------------------------------------------------------------------------- a folder there


def test_a_file_is_read_in_pieces_from_where_to_where_it_was_asked_for(tmp_path: Path) -> None:
    data = bytes(k % 251 for k in range(5 * MB // 2))
    (tmp_path / "f").write_bytes(data)
    source = FolderSource(tmp_path)
    assert [len(one) for one in source.read("f", 0, 1 << 40)] == [MB, MB, MB // 2]
    assert [len(one) for one in source.read("f", 0, 2 * MB)] == [MB, MB]
    assert b"".join(source.read("f", 7, MB + 9)) == data[7 : MB + 9]
    assert list(source.read("f", 7, 7)) == []


def test_a_listing_tells_size_kind_and_time_in_order(tmp_path: Path) -> None:
    (tmp_path / "b").write_bytes(b"12345")
    (tmp_path / "a").mkdir()
    (tmp_path / "c").symlink_to(tmp_path / "b")
    folder, file = FolderSource(tmp_path).listing("")
    assert (folder.name, folder.folder) == ("a", True)
    assert file == RemoteEntry("b", 5, False)
    assert is_linked(tmp_path, "c/x")
    assert not is_linked(tmp_path, "a/x")


@pytest.mark.parametrize(
    ("code", "error"),
    [
        *((code, NotThere) for code in (errno.ENOENT, errno.ENOTDIR)),
        *((code, LinkLost) for code in (errno.EIO, errno.ENODEV, errno.ENXIO, errno.ESTALE, errno.ENOTCONN)),
        *((code, LinkLost) for code in (errno.EHOSTDOWN, errno.ETIMEDOUT)),
        *((code, Unreadable) for code in (errno.EACCES, errno.EISDIR, errno.ENAMETOOLONG)),
    ],
)
def test_an_error_of_the_disk_is_gone_a_broken_link_or_unreadable(
    code: int, error: type[Exception], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_path: Path) -> Iterator[Path]:
        raise OSError(code, "why")

    monkeypatch.setattr(Path, "iterdir", fail)
    with pytest.raises(error, match=r"scans: why$"):
        FolderSource(tmp_path).listing("scans")


@pytest.mark.parametrize("over", [0, 1])
def test_a_small_file_is_read_up_to_its_limit_and_never_further(tmp_path: Path, over: int) -> None:
    asked: list[int] = []

    class Watched(FolderSource):
        def read(self, path: str, start: int, end: int) -> Iterator[bytes]:
            asked.append(end)
            return super().read(path, start, end)

    (tmp_path / "f").write_bytes(b"x" * (10 + over))
    if over:
        with pytest.raises(Unreadable, match="f: more than 10 bytes"):
            text_of(Watched(tmp_path), "f", 10)
    else:
        assert text_of(Watched(tmp_path), "f", 10) == b"x" * 10
    assert asked == [11]


# --------------------------------------------------------------------------------- beside the scans


@pytest.mark.parametrize("place", ["../instrument/rig.toml", "instrument/rig.toml", "../../etc/kingfisher/rig.toml"])
def test_the_rig_file_is_found_wherever_an_instrument_shows_it(there: Path, here: Path, place: str) -> None:
    (there / place).parent.mkdir(parents=True)
    (there / place).write_text(place)
    (there / place).with_name("another").write_text("")
    done = pulled(FolderSource(there), here)
    assert (here / "instrument" / "rig.toml").read_text() == place
    assert (done.whole, done.taken_bytes) == (True, len(place))


def test_the_instruments_own_word_comes_before_its_disks(there: Path, here: Path) -> None:
    for place in ("../instrument", "instrument", "../../etc/kingfisher"):
        (there / place).mkdir(parents=True)
        (there / place / "rig.toml").write_text(place)
    pulled(FolderSource(there), here)
    assert (here / "instrument" / "rig.toml").read_text() == "../instrument"


def test_small_files_are_taken_to_a_depth_of_four_folders_and_by_their_kind(there: Path, here: Path) -> None:
    for folder in ("objects", "objects/1/2/3", "objects/1/2/3/4"):
        (there / folder).mkdir(parents=True, exist_ok=True)
        for name in ("a.json", "b.html", "c.toml", "d.ply", "e.json.tmp"):
            (there / folder / name).write_text("{}")
    assert pulled(FolderSource(there), here).whole
    taken = {path for path in content(here) if path.startswith("objects/")}
    assert taken == {
        f"{folder}/{name}" for folder in ("objects", "objects/1/2/3") for name in ("a.json", "b.html", "c.toml")
    }


class Odd(FolderSource):
    """A place where some is not to be had."""

    def __init__(self, root: Path) -> None:
        super().__init__(root)
        self.error: Exception | None = None
        self.asked: list[int] = []

    def listing(self, folder: str) -> list[RemoteEntry]:
        if folder == "objects" and self.error is not None:
            raise self.error
        return super().listing(folder)

    def read(self, path: str, start: int, end: int) -> Iterator[bytes]:
        if self.error is not None:
            raise self.error
        self.asked.append(end)
        return super().read(path, start, end)


@pytest.fixture
def odd(there: Path) -> Odd:
    (there / "calibration").mkdir()
    (there / "calibration" / "odd.json").write_text("{}")
    return Odd(there)


def test_a_small_file_has_up_to_50_mb(odd: Odd, here: Path) -> None:
    pulled(odd, here)
    assert odd.asked == [50_000_001], "one byte more tells that it is longer"


@pytest.mark.parametrize(
    ("error", "outcome", "said"),
    [
        (NotThere("x"), PullOutcome.LATER, {"calibration/odd.json": "was moved or changed there meanwhile (x)"}),
        (
            Unreadable("x"),
            PullOutcome.FAILED,
            {"calibration/odd.json": "cannot be read there: x", "objects": "cannot be read there: x"},
        ),
    ],
)
def test_a_small_file_that_is_not_given_is_told(
    odd: Odd, here: Path, error: Exception, outcome: PullOutcome, said: dict[str, str]
) -> None:
    odd.error = error
    done = pulled(odd, here)
    assert reasons(done, outcome) == said
    assert not done.whole


def test_what_is_here_already_is_told_so_and_a_second_version_by_its_name(odd: Odd, there: Path, here: Path) -> None:
    pulled(odd, here)
    assert reasons(pulled(odd, here), PullOutcome.ALREADY) == {"calibration/odd.json": ""}
    (there / "calibration" / "odd.json").write_text("[]")
    (copy,) = pulled(odd, here).of(PullOutcome.TAKEN)
    assert copy.size_bytes == 2
    beside = here / "calibration" / copy.reason.removeprefix("as ")
    assert beside.read_text() == "[]"
    beside.write_text("something else")
    done = pulled(odd, here)
    assert "is here twice with other content" in reasons(done, PullOutcome.DIFFERS)["calibration/odd.json"]
    assert not done.whole


# -------------------------------------------------------------------------------------- a recording


def test_what_cannot_be_a_recording_is_told(there: Path, here: Path) -> None:
    for number in ("000001", "000002", "000003", "000004"):
        scan(there, number)
    (there / "scans" / "000001" / "manifest.json").unlink()
    (there / "scans" / "000002" / "manifest.json").write_text("{}")
    (there / "scans" / "000003" / "cloud.ply").unlink()
    (there / "scans" / "000004").rename(there / "scans" / "000005")
    said = reasons(pulled(FolderSource(there), here), PullOutcome.FAILED)
    assert said["scans/000001"] == "scans/000001: has no manifest there; look at it on the instrument"
    assert said["scans/000002"].startswith("its manifest cannot be used there: ")
    assert said["scans/000003"] == "scans/000003: cloud.ply missing there"
    assert said["scans/000005"] == "scans/000005: its manifest is of scan 000004"


def test_a_scan_that_is_damaged_here_is_told_and_left(there: Path, here: Path) -> None:
    scan(there, "000001")
    pulled(FolderSource(there), here)
    (here / "scans" / "000001" / "cloud.ply").write_bytes(b"ply")
    said = reasons(pulled(FolderSource(there), here), PullOutcome.FAILED)["scans/000001"]
    assert "is here, and damaged" in said
    assert "cloud.ply" in said
    (here / "scans" / "000001" / "manifest.json").unlink()
    said = reasons(pulled(FolderSource(there), here), PullOutcome.DIFFERS)["scans/000001"]
    assert "not the same at both ends, and left alone" in said


@pytest.mark.parametrize("path", ["scans/000002/rig.toml", "incomplete/000001/frames_left.npy"])
def test_a_recording_is_read_three_times_until_it_counts_as_damaged_there(
    tmp_path: Path, here: Path, path: str
) -> None:
    root = instrument(tmp_path / "other")
    done = pulled(FlippingSource(root, path, 3), here)
    folder, _, name = path.rpartition("/")
    said = reasons(done, PullOutcome.FAILED)
    assert list(said) == [folder]
    assert name in said[folder]
    assert said[folder].endswith("(read 3 times)")
    assert pulled(FlippingSource(root, path, 2), here.with_name("again")).whole


def test_pieces_of_a_mebibyte_are_written_and_told(there: Path, here: Path) -> None:
    folder = scan(there, "000001")
    (folder / "notes.bin").write_bytes(bytes(5 * MB // 2))
    came: list[int] = []
    target = here / "scans" / "000001"
    target.parent.mkdir(parents=True)
    found = find(FolderSource(there), "scans/000001")
    assert already_here_bytes(found, target) == 0
    take(found, FolderSource(there), FS, target, came.append)
    assert [one for one in came if one >= MB // 2] == [MB, MB, MB // 2]
    assert sum(came) == found.size_bytes
    draft_folder(target).mkdir()
    (draft_folder(target) / "cloud.ply").write_bytes(b"123")
    assert already_here_bytes(found, target) == 3
    with pytest.raises(NotYet) as caught:
        present(found, FolderSource(there), FS, target)
    assert caught.value.outcome is PullOutcome.ALREADY
