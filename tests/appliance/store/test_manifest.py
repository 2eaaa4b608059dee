"""What a manifest and its kin may say: read field by field as pydantic would, and no name in them leads out of their folder."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from appliance.base.sealed_file import ContentError, shaped
from appliance.desk import object_store as objects
from appliance.desk.object_store import CloudFacts, MemberScan, ObjectError, StoredObject
from appliance.instrument.service.gallery import read
from appliance.measure.fault import FaultCode
from appliance.measure.light.exposure import Exposure
from appliance.measure.light.patterns import STEP_ORDERS, build_sequence
from appliance.measure.verdict import GRADE_NAME, Grade, Verdict
from appliance.store import incomplete
from appliance.store import manifest as form
from appliance.store.atomic import LocalFileSystem, Stamp
from appliance.store.library import Library, UnknownScan
from appliance.store.manifest import Decision, Manifest, ScanRecord, SecondSequence, SequenceInfo, Stage
from appliance.store.names import is_component
from appliance.store.scan import ScanError, StoredScan, cloud_bytes, frames_bytes, map_frames, write_raw
from tests.appliance.store.scenes import ORIGIN, cloud, frames, record, second_sequence
from tests.appliance.store.test_objects import PLACE, PLACES
from tests.support.sealing import sealed

MANIFEST = Manifest("000001", Stage.RAW, Decision.UNDECIDED, record(), {}, frame_crc32={})


ORACLE = TypeAdapter(Manifest)
OTHERS: tuple[Any, ...] = (None, True, False, 0, 1, -3, 1.0, 2.5, "x", "", [], {}, [1], {"a": 1}, "kept", "raw", ...)
"""``...``: the key is not there."""


def whole() -> dict[str, Any]:
    """A manifest with something in every field, as JSON has it."""
    verdicts = (Verdict("moved", None, {"shift_px": 1.0, "sigma_px": None}, "text"), Verdict("identity", True))
    complete = record(
        second=second_sequence(), exposure=Exposure(8000, 1.5), verdicts=verdicts, cloud={"points": 20, "noise_mm": 0.5}
    )
    manifest = replace(MANIFEST, record=complete, files={"f": Stamp(3, "ab")}, frame_crc32={"f": ("1", "2")})
    found: dict[str, Any] = json.loads(json.dumps(manifest.as_json()))
    del found["schema"]
    return found


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    if path:
        yield path
    children = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, one in children:
        yield from places(one, (*path, key))


def changed(path: tuple[Any, ...], other: Any) -> dict[str, Any]:
    content = whole()
    at: Any = content
    for key in path[:-1]:
        at = at[key]
    if other is ...:
        del at[path[-1]]
    else:
        at[path[-1]] = other
    return content


def read_by(reader: Callable[[dict[str, Any]], object], content: dict[str, Any]) -> str | None:
    try:
        return repr(reader(content))
    except (ContentError, ValidationError):
        return None


def by_us(content: dict[str, Any]) -> Manifest:
    return shaped(Manifest, content)


@pytest.mark.parametrize("other", OTHERS, ids=repr)
def test_every_field_with_something_else_in_it_is_read_or_refused_as_by_pydantic(other: Any) -> None:
    assert read_by(by_us, whole()) == read_by(ORACLE.validate_python, whole()) is not None
    tried = {path: changed(path, other) for path in places(whole())}
    wrong = [path for path, one in tried.items() if read_by(by_us, one) != read_by(ORACLE.validate_python, one)]
    assert wrong == []


@pytest.mark.parametrize(
    ("path", "other", "said"),
    [
        ("record.exposure.time_us", 1.5, "1.5"), ("record.exposure.gain_db", 10**400, "a number"), ("record.exposure.time_us", float("inf"), "a number"),
        ("record.exposure.time_us", float("nan"), "a number"), ("record.verdicts.0.name", 3, "is 3; allowed: a text"), ("record.rig_hash", ..., "is missing"),
        ("stage", "cooked", "'raw' or 'complete'"), ("files", [], "an object"), ("recovered", "perhaps", "'perhaps'"),
    ],
)  # fmt: skip
def test_the_first_wrong_field_is_named_with_what_is_expected(path: str, other: Any, said: str) -> None:
    at = tuple(int(key) if key.isdigit() else key for key in path.split("."))
    with pytest.raises(ContentError, match=rf"^{path} .*{said}"):
        by_us(changed(at, other))


def test_a_manifest_has_a_checksum_16_mib_and_this_schema(tmp_path: Path) -> None:
    data = form.encode(MANIFEST)
    content = {key: value for key, value in json.loads(data).items() if key != "sha256"}
    for wrong, said in (
        (data.replace(b"41.5", b"21.5"), "checksum"), (b'{"a": NaN}', "NaN"), (b'{"a": 1e999}', "1e999"),
        (sealed({**content, "schema": 2}), "schema 2"), (sealed({**content, "stage": "half"}), "stage is "),
    ):  # fmt: skip
        with pytest.raises(ContentError, match=f"^here: .*{said}"):
            form.MANIFEST.decode(wrong, "here")
    for length, taken in ((16 * 1024 * 1024, True), (16 * 1024 * 1024 + 1, False)):
        (tmp_path / "manifest.json").write_bytes(data[:-2] + b" " * (length - len(data)) + data[-2:])
        if taken:
            assert form.read(tmp_path).scan_id == "000001"
        else:
            with pytest.raises(ContentError, match="16777216"):
                form.read(tmp_path)


def test_numbers_of_numpy_are_written_times_that_are_not_known_are_left_out_and_nothing_else_is_made_fit() -> None:
    numbers = {"a": np.float32(0.5), "b": np.int64(7), "c": float("nan")}
    times = {"full": 1.5, "coarse": float("nan"), "saved": float("inf")}
    found = form.MANIFEST.decode(
        form.encode(replace(MANIFEST, record=record(cloud=numbers, stage_times_s=times))), "here"
    ).record
    assert (found.cloud, dict(found.stage_times_s)) == ({"a": 0.5, "b": 7.0, "c": None}, {"full": 1.5})
    for value in (b"bytes", object()):
        with pytest.raises(TypeError, match="JSON"):
            form.encode(replace(MANIFEST, record=record(ledger={"a": value})))


@pytest.mark.parametrize(
    ("old", "new"),
    [("3, 8, 10)", "2, 8, 10)"), ("8, 10)", "8, 9) "), ("(3, 8, 10)", "(3, 0, 80)"), ("(3, 8", "((3,8"), ("'|u1'", "'|O' ")],
)  # fmt: skip
def test_a_file_whose_header_says_something_else_is_not_mapped(tmp_path: Path, old: str, new: str) -> None:
    write_raw(LocalFileSystem(), tmp_path / "000001", "000001", frames(), record(), ORIGIN)
    path = tmp_path / "000001" / "frames_right.npy"
    data = path.read_bytes()
    assert len(data) == frames_bytes(3, 10, 8) == 128 + 3 * 80, "what is reserved for it"
    assert 25 * 640 * 480 + 600 < cloud_bytes(640, 480) < 25 * 640 * 480 + 10_000
    assert len(map_frames(path, 3)) == 3
    path.write_bytes(data.replace(old.encode(), new.encode(), 1))
    assert (path.stat().st_size, path.read_bytes() == data) == (len(data), False)
    with pytest.raises(ScanError, match=r"frames_right\.npy"):
        StoredScan.load(tmp_path / "000001")
    np.save(path, frames()["right"])
    assert np.array_equal(StoredScan.load(tmp_path / "000001").frames["right"], frames()["right"]), (
        "NumPy's own header is read"
    )
    path.unlink()
    with pytest.raises(ScanError, match=r"frames_right\.npy"):
        map_frames(path, 3)


def test_frames_of_another_form_are_refused_before_anything_is_made(tmp_path: Path) -> None:
    for shape, dtype in (((3, 8), np.uint8), ((3, 8, 10), np.uint16), ((4, 8, 10), np.uint8), ((2, 8, 10), np.uint8)):
        for side in ("left", "right"):
            given = {**frames(), side: np.zeros(shape, dtype)}
            with pytest.raises(ValueError, match=rf"{side} frames"):
                write_raw(LocalFileSystem(), tmp_path / "000001", "000001", given, record(), ORIGIN)
    assert list(tmp_path.iterdir()) == []


BAD = (
    "../x", "../../../../ESCAPED", "/etc/x", "..", ".", "a/b", "a\\b", "~x", "", "a\0b", "a\nb", "a\x1b[2J", "a\u202eb", ".hidden", "-rf", " x", "x.",
    "con:1", "x" * 101, "東" * 70, "a\u0308",
)  # fmt: skip
OBJECT = StoredObject("hull", (MemberScan("000001", "scans/000001", ("aa",)),), PLACES)


def broken_off(manifest: Manifest) -> bytes:
    return sealed({**manifest.as_json(), **incomplete.INCOMPLETE_OF, "missing": []})


def read_object(root: Path, stored: StoredObject) -> None:
    """As another program would have written it."""
    folder = root / "objects" / "hull"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / objects.FILE).write_bytes(objects.OBJECT.encode(stored))
    objects.read_object(root, "hull")


def of_places(**changes: Any) -> StoredObject:
    return replace(OBJECT, places=replace(PLACES, **changes))


REFUSING: dict[str, Callable[[Path, str], object]] = {
    "a manifest's scan_id": lambda _, bad: form.MANIFEST.decode(form.encode(replace(MANIFEST, scan_id=bad)), "there"),
    "a manifest's files": lambda _, bad: form.MANIFEST.decode(form.encode(replace(MANIFEST, files={bad: Stamp(1, "aa")})), "there"),
    "a broken recording's scan_id": lambda _, bad: incomplete.INCOMPLETE.decode(broken_off(replace(MANIFEST, scan_id=bad)), "there", incomplete.INCOMPLETE_OF),
    "a broken recording's files": lambda _, bad: incomplete.INCOMPLETE.decode(broken_off(replace(MANIFEST, files={bad: Stamp(1, "aa")})), "there", incomplete.INCOMPLETE_OF),
    "an object's scans": lambda root, bad: read_object(root, replace(OBJECT, scans=(MemberScan(bad, "scans/1", ()),))),
    "an object's places": lambda root, bad: read_object(root, of_places(places={bad: PLACE})),
    "an object's scans left out": lambda root, bad: read_object(root, of_places(left_out={bad: "slides"})),
    "an object's clouds": lambda root, bad: read_object(root, of_places(clouds={bad: CloudFacts(9, 540.0, 0.02, None, None)})),
    "the first of an object's pairs": lambda root, bad: read_object(root, of_places(pairs=(replace(PLACES.pairs[0], first=bad),))),
    "the second of an object's pairs": lambda root, bad: read_object(root, of_places(pairs=(replace(PLACES.pairs[0], second=bad),))),
    "an object's name": objects.read_object,
    "a scan's number": lambda root, bad: Library(root).entry(bad),
}  # fmt: skip
"""Whatever reads a name, with a storage root of its own and that name."""


@pytest.mark.parametrize("reader", REFUSING)
def test_a_name_that_leads_out_of_its_folder_is_refused_where_it_is_read(reader: str, tmp_path: Path) -> None:
    for bad in (*BAD, *(("manifest.json",) if reader == "a manifest's files" else ())):
        with pytest.raises((ContentError, ScanError, ObjectError, UnknownScan)):
            REFUSING[reader](tmp_path, bad)
    if reader == "an object's scans":
        for folder in ("../scans/000001", "scans/../../x", "a\0b"):
            with pytest.raises(ObjectError, match="000001"):
                read_object(tmp_path, replace(OBJECT, scans=(MemberScan("000001", folder, ()),)))


def test_names_that_people_and_the_program_give_are_taken(tmp_path: Path) -> None:
    assert all(map(is_component, ("000001", "000007-2", "frames_left.npy", "skull 3ps", "Straße", "1+2", "スキャン")))
    objects.write(tmp_path, OBJECT)
    (tmp_path / "objects" / "hull").rename(tmp_path / "objects" / "bow")
    assert objects.read_object(tmp_path, "bow").name == "bow", "an object is called as its folder is"


CLOUD = {"points": 20, "coverage_percent": 81.5, "noise_mm": 0.03, "distance_mm": 512.0, "gap_mm": 0.0002}
UNDONE = Verdict("compensation", True, {}, "Motion of 3.1 px during the x fringes was undone")


def causes(*codes: FaultCode) -> Verdict:
    return Verdict("causes", not codes, {f"{code.value.lower()}_percent": 7.0 for code in codes})


def of(*verdicts: Verdict, **changes: object) -> ScanRecord:
    return record(cloud=CLOUD, verdicts=verdicts, **changes)


def test_a_stored_scan_has_one_grade_the_word_that_the_diver_read(tmp_path: Path) -> None:
    assert of(causes(FaultCode.MOVED), Verdict(GRADE_NAME, True, {}, "good")).grade is Grade.GOOD
    assert of(Verdict(GRADE_NAME, True, {}, "splendid")).grade is of(causes()).grade is None
    library = Library(tmp_path)
    library.prepare()
    for verdicts in ((UNDONE,), ()):
        kept = of(Verdict(GRADE_NAME, True, {}, "usable"), *verdicts)
        pending = library.begin(frames(), kept, ORIGIN)
        pending.publish(kept, cloud())
        shown = read(library, pending.scan_id)
        assert (shown.grade, shown.corrected) == (Grade.USABLE, bool(verdicts))


def test_what_a_second_exposure_made_up_for_is_not_held_against_a_pair() -> None:
    second = SecondSequence(Exposure(3_000), 99, verdicts=(causes(FaultCode.TOO_DARK, FaultCode.AMBIENT),))
    pair = Verdict("pair", True)
    assert of(causes(FaultCode.TOO_BRIGHT), pair, second=second).held_against == (FaultCode.AMBIENT,)
    assert of(causes(FaultCode.TOO_BRIGHT), second=second).held_against == (FaultCode.TOO_BRIGHT,)


def test_a_compensated_scan_has_no_ray_gap() -> None:
    """Its rows come from the model: 0.2 µm would look like a perfect calibration."""
    assert (of(UNDONE).gap_mm, of(UNDONE).compensated) == (None, True)
    plain = of(replace(UNDONE, passed=False))
    assert (plain.gap_mm, plain.compensated) == (0.0002, False)


@pytest.mark.parametrize("steps", STEP_ORDERS)
def test_a_scan_says_in_which_order_its_steps_were_projected(tmp_path: Path, steps: tuple[int, ...]) -> None:
    sequence = build_sequence(16, steps=steps)
    manifest = replace(MANIFEST, record=record(sequence=SequenceInfo.of(sequence)))
    assert StoredScan(tmp_path, manifest, {}).sequence == sequence


def test_patterns_that_are_no_sequence_are_named_with_the_folder(tmp_path: Path) -> None:
    with pytest.raises(ScanError, match=rf"{tmp_path}: patterns bright, dark, gray-x-0: no sequence of 16 px"):
        StoredScan(tmp_path, MANIFEST, {}).sequence  # noqa: B018
