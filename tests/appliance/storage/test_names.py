"""A strange scan, object or root cannot write outside of the folder that it was given: each reader looks at each name that it finds."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import nullcontext, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from appliance.calibration.guide import Session
from appliance.checksummed_file import with_checksum
from appliance.offline.pull.pulling import pull
from appliance.offline.pull.source import FolderSource, RemoteEntry
from appliance.storage import incomplete, objects
from appliance.storage import manifest as form
from appliance.storage.atomic import Stamp
from appliance.storage.calibrations import Calibrations
from appliance.storage.filesystem import LocalFileSystem
from appliance.storage.library import Library, UnknownScan
from appliance.storage.manifest import Decision, Manifest, ManifestError, Stage
from appliance.storage.names import is_component
from appliance.storage.objects import CloudFacts, MemberScan, ObjectError, StoredObject
from appliance.storage.scan import ScanError
from tests.appliance.storage.scenes import record
from tests.appliance.storage.test_objects import PLACE, PLACES

LEADING_OUT = ["../x", "../../../../ESCAPED", "/etc/x", "..", ".", "a/b", "a\\b", "~x"]
ODD = [
    "",
    "a\0b",
    "a\nb",
    "a\x1b[2J",
    "a\u202eb",
    ".hidden",
    "-rf",
    " x",
    "x.",
    "con:1",
    "x" * 101,
    "東" * 70,
    "a\u0308",
]
MANIFEST = Manifest("000001", Stage.RAW, Decision.UNDECIDED, record(), {}, frame_crc32={})
OBJECT = StoredObject("hull", (MemberScan("000001", "scans/000001", ("aa",)),), PLACES)


def bytes_of(manifest: Manifest) -> bytes:
    return form.encode(manifest)


def broken_off(manifest: Manifest) -> bytes:
    return with_checksum({**form.as_json(manifest), "kind": incomplete.KIND, "missing": []})


def read_object(root: Path, stored: StoredObject) -> None:
    """As another program would have written it."""
    folder = root / "objects" / "hull"
    folder.mkdir(parents=True)
    content = objects._form().dump_python(stored, mode="json")
    (folder / objects.FILE).write_bytes(with_checksum(content))
    objects.read(root, "hull")


def of_places(**changes: Any) -> StoredObject:
    return replace(OBJECT, places=replace(PLACES, **changes))


REFUSING: dict[str, Callable[[Path, str], object]] = {
    "a manifest's scan_id": lambda _, bad: form.decode(bytes_of(replace(MANIFEST, scan_id=bad)), "there"),
    "a manifest's files": lambda _, bad: form.decode(bytes_of(replace(MANIFEST, files={bad: Stamp(1, "aa")})), "there"),
    "a broken recording's scan_id": lambda _, bad: incomplete.decode(broken_off(replace(MANIFEST, scan_id=bad)), "there"),
    "a broken recording's files": lambda _, bad: incomplete.decode(
        broken_off(replace(MANIFEST, files={bad: Stamp(1, "aa")})), "there"
    ),
    "an object's scans": lambda root, bad: read_object(root, replace(OBJECT, scans=(MemberScan(bad, "scans/1", ()),))),
    "an object's places": lambda root, bad: read_object(root, of_places(places={bad: PLACE})),
    "an object's scans left out": lambda root, bad: read_object(root, of_places(left_out={bad: "slides"})),
    "an object's clouds": lambda root, bad: read_object(root, of_places(clouds={bad: CloudFacts(9, 540.0, 0.02, None, None)})),
    "the first of an object's pairs": lambda root, bad: read_object(root, of_places(pairs=(replace(PLACES.pairs[0], first=bad),))),
    "the second of an object's pairs": lambda root, bad: read_object(root, of_places(pairs=(replace(PLACES.pairs[0], second=bad),))),
    "an object's name": objects.read,
    "a scan's number": lambda root, bad: Library(root).entry(bad),
}  # fmt: skip
"""Whatever reads a name, with a storage root of its own and that name."""


@pytest.mark.parametrize("bad", [*LEADING_OUT, *ODD], ids=ascii)
@pytest.mark.parametrize("reader", REFUSING)
def test_a_name_that_leads_out_of_its_folder_is_refused_where_it_is_read(reader: str, bad: str, tmp_path: Path) -> None:
    with pytest.raises((ManifestError, ScanError, ObjectError, UnknownScan)):
        REFUSING[reader](tmp_path, bad)


def test_a_number_of_thousands_of_digits_is_no_scans(tmp_path: Path) -> None:
    (tmp_path / "scans" / "000001").mkdir(parents=True)
    assert {Library(tmp_path).entry(number).scan_id for number in ("1", "01", "000001", "0000001")} == {"000001"}
    for number in ("1" * 5000, "0" * 5000, "²"):
        with pytest.raises(UnknownScan):
            Library(tmp_path).entry(number)


@pytest.mark.parametrize("bad", ["../scans/000001", "000001/../000001", "kept", ".000001", ""])
def test_a_recordings_number_is_no_path(bad: str, tmp_path: Path) -> None:
    for folder in ("incomplete/000001", "incomplete/000000", "incomplete/.000001", "incomplete/00kept", "scans/000001"):
        (tmp_path / folder).mkdir(parents=True)
    assert incomplete.find(tmp_path, "1") == tmp_path / "incomplete" / "000001"
    with pytest.raises(ScanError):
        incomplete.find(tmp_path, bad)


@pytest.mark.parametrize("bad", ["../scans/000001", "scans/../../x", "a\0b"])
def test_an_objects_scans_lie_below_the_root_or_at_a_whole_path(bad: str, tmp_path: Path) -> None:
    with pytest.raises(ObjectError, match="the folder of scan 000001"):
        read_object(tmp_path, replace(OBJECT, scans=(MemberScan("000001", bad, ()),)))


def test_an_object_is_called_as_its_folder_is(tmp_path: Path) -> None:
    objects.write(tmp_path, OBJECT)
    (tmp_path / "objects" / "hull").rename(tmp_path / "objects" / "bow")
    assert objects.read(tmp_path, "bow").name == "bow"


@pytest.mark.parametrize("bad", [*LEADING_OUT, *ODD, "٠٠٠١-2026-01-01.json"], ids=ascii)
def test_a_kept_calibration_of_another_form_is_none(bad: str, tmp_path: Path) -> None:
    kept = Calibrations(tmp_path, "KF-0001")
    kept.write(Session())
    path = kept.folder / "session" / "session.json"
    content = json.loads(path.read_bytes())
    del content["sha256"]
    path.write_bytes(with_checksum({**content, "kept": bad}))
    with suppress(OSError, ValueError):  # where a file can be called so, it is there
        place = (kept.folder / "kept" / bad).resolve()
        if place.is_relative_to(tmp_path):
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_bytes(b"{}")
    assert kept.session().kept is None


class OddRoot(FolderSource):
    """A storage root whose every folder lists a file and a folder of an odd name besides."""

    def __init__(self, root: Path, name: str) -> None:
        super().__init__(root)
        self._name = name

    def listing(self, folder: str) -> list[RemoteEntry]:
        return [
            *super().listing(folder),
            *(RemoteEntry(f"{self._name}{end}", 5, end == "") for end in ("", ".json")),
        ]


@pytest.mark.parametrize("bad", ["../x", "/etc/x", "..", "a/b", ".hidden", "-rf", "a\x1b[2J"], ids=ascii)
def test_a_root_that_lists_odd_names_gives_none_of_them(bad: str, tmp_path: Path) -> None:
    (tmp_path / "there" / "scans").mkdir(parents=True)
    (tmp_path / "there" / "calibration").mkdir()
    (tmp_path / "here").mkdir()
    done = pull(
        lambda: nullcontext(OddRoot(tmp_path / "there", bad)), tmp_path / "here", LocalFileSystem(), every=True, far=lambda _: None,
        wait=lambda _: None,
    )  # fmt: skip
    assert done.came == {}
    assert [path for path in (tmp_path / "here").rglob("*") if path.is_file()] == []


@pytest.mark.parametrize("good", ["000001", "000007-2", "frames_left.npy", "skull 3ps", "Straße", "1+2", "スキャン"])
def test_names_that_people_and_the_program_give_are_taken(good: str) -> None:
    assert is_component(good)
