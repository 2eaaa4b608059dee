"""What is kept of an object: it comes back as it was, and damage, doubles and odd names are told."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from appliance.desk import object_store as objects
from appliance.desk.object_store import (
    ADDED_SINCE,
    MemberScan,
    ObjectError,
    PackedMatrix,
    Places,
    ScanPlace,
    StoredObject,
)

PLACE = ScanPlace(
    rotation=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), translation_mm=(1.0, 2.0, 3.0), middle_mm=(10.0, 20.0, 530.0),
    sigma_mm=0.02, covariance=((0.0,) * 6,) * 6, bending_mm=0.01, bending_unaided_mm=0.4, bending_aided_mm=0.05,
)  # fmt: skip
MATRIX = PackedMatrix.of(np.eye(6))
PLACES = Places(
    calibrations=("ab" * 32,), water_index=(1.335,), places={"000001": PLACE}, clouds={}, left_out={"000002": "slides"}, warnings=("look here",),
    pairs=(objects.ComparedScans("000001", "000002", False, False, "slides", 80.0, None, None),),
    shared_error_mm=(0.0,) * 7, shared_error_spread_mm=0.02, shared_error_aided_mm=0.005, shared_error_removed=False, shared_error_score=None,
    variance_factor=1.0, joint=objects.JointPlaces(("000001",), MATRIX, MATRIX, MATRIX, 500.0),
)  # fmt: skip
OBJECT = StoredObject("hull 3", (MemberScan("000001", "scans/000001", ("aa", "bb")),), PLACES)


def test_an_object_comes_back_as_it_was_written_and_damage_and_odd_names_are_told(tmp_path: Path) -> None:
    for name in ("", "../x", "a/b", ".hidden", "x" * 65, "end ", "end."):
        with pytest.raises(ObjectError, match="1 to 64"):
            objects.write(tmp_path, replace(OBJECT, name=name))
    assert not list(tmp_path.iterdir())
    objects.write(tmp_path, OBJECT)
    assert objects.read_object(tmp_path, "hull 3") == OBJECT
    assert objects.object_names(tmp_path) == ["hull 3"]
    with pytest.raises(ObjectError, match=r"'reef'.*hull 3"):
        objects.read_object(tmp_path, "reef")
    path = tmp_path / "objects" / "hull 3" / "object.json"
    path.write_text(path.read_text().replace("0.02", "0.03"))
    with pytest.raises(ObjectError, match="damaged"):
        objects.read_object(tmp_path, "hull 3")


def scan(number: int) -> MemberScan:
    return MemberScan(f"{number:06d}", f"scans/{number:06d}", (f"of {number}",))


def with_more(*numbers: int) -> Callable[[StoredObject | None], StoredObject]:
    added = tuple(scan(number) for number in numbers)
    return lambda now: objects.with_scans(StoredObject("hull 3") if now is None else now, added)


def solved(*numbers: int) -> StoredObject:
    places = {f"{number:06d}": PLACE for number in numbers}
    return StoredObject("hull 3", tuple(map(scan, numbers)), replace(PLACES, places=places, left_out={}))


def test_a_scan_that_is_added_also_while_the_object_is_solved_is_not_lost_and_has_no_place_yet(tmp_path: Path) -> None:
    def places_are_those_of_the_first_two(stored: StoredObject) -> None:
        assert stored == objects.read_object(tmp_path, "hull 3")
        assert [one.name for one in stored.scans] == ["000001", "000002", "000003"]
        assert stored.places is not None
        assert sorted(stored.places.places) == ["000001", "000002"]
        assert stored.places.left_out == {"000003": ADDED_SINCE}

    objects.write(tmp_path, solved(1, 2))
    places_are_those_of_the_first_two(objects.update_object(tmp_path, "hull 3", with_more(3)))
    objects.write(tmp_path, StoredObject("hull 3"))
    objects.update_object(tmp_path, "hull 3", with_more(1, 2, 3))
    places_are_those_of_the_first_two(
        objects.update_object(tmp_path, "hull 3", lambda now: objects.merge_places(now, solved(1, 2)))
    )


def test_scans_that_are_added_at_once_are_all_in_the_object(tmp_path: Path) -> None:
    objects.update_object(tmp_path, "hull 3", with_more(1))
    together = threading.Barrier(3, timeout=20.0)

    def add(number: int) -> None:
        add_one = with_more(number)

        def slowly(now: StoredObject | None) -> StoredObject:
            time.sleep(0.02)  # between reading and writing, where the others read
            return add_one(now)

        together.wait()
        objects.update_object(tmp_path, "hull 3", slowly)

    with ThreadPoolExecutor(3) as pool:
        list(pool.map(add, (2, 3, 4)))
    assert sorted(one.name for one in objects.read_object(tmp_path, "hull 3").scans) == [
        f"{k:06d}" for k in (1, 2, 3, 4)
    ]


def test_places_do_not_replace_those_of_more_scans_or_of_an_object_that_was_made_again(tmp_path: Path) -> None:
    objects.write(tmp_path, solved(1, 2, 3))
    with pytest.raises(ObjectError, match="was meanwhile solved with 000003, too"):
        objects.update_object(tmp_path, "hull 3", lambda now: objects.merge_places(now, solved(1, 2)))
    assert objects.read_object(tmp_path, "hull 3") == solved(1, 2, 3)
    for now in (None, solved(1, 3)):
        with pytest.raises(ObjectError, match="was made again during solving"):
            objects.merge_places(now, solved(1, 2))
    again = replace(solved(1, 2), scans=(scan(1), replace(scan(2), frames_sha256=("other frames",))))
    with pytest.raises(ObjectError, match="was made again"):
        objects.merge_places(again, solved(1, 2))


def test_a_scan_is_not_taken_twice_under_whatever_name() -> None:
    with pytest.raises(ObjectError, match="000009 is already in it as 000001"):
        objects.with_scans(OBJECT, (MemberScan("000009", "copy/000009", ("aa", "bb")),))
    with pytest.raises(ObjectError, match="another scan called 000001"):
        objects.with_scans(OBJECT, (MemberScan("000001", "elsewhere/000001", ("dd",)),))


def test_a_kept_cloud_is_used_only_for_what_it_was_made_from(tmp_path: Path) -> None:
    objects.write(tmp_path, OBJECT)
    points = np.arange(12, dtype=np.float32).reshape(2, 2, 3)
    objects.save_cloud(tmp_path, "hull 3", "000001", "key", {"points_mm": points})
    kept = objects.load_cloud(tmp_path, "hull 3", "000001", "key")
    assert kept is not None
    np.testing.assert_array_equal(kept["points_mm"], points)
    assert objects.load_cloud(tmp_path, "hull 3", "000001", "other key") is None
    path = tmp_path / "objects" / "hull 3" / "clouds" / "000001.npz"
    path.write_bytes(path.read_bytes()[:100])
    assert objects.load_cloud(tmp_path, "hull 3", "000001", "key") is None, "it is made again"
