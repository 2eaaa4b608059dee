"""What is kept of an object: it comes back as it was, and damage, doubles and odd names are told."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from appliance.storage import objects
from appliance.storage.objects import ComparedScans, MemberScan, ObjectError, Places, ScanPlace, StoredObject

PLACE = ScanPlace(
    rotation=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    translation_mm=(1.0, 2.0, 3.0),
    middle_mm=(10.0, 20.0, 530.0),
    sigma_mm=0.02,
    covariance=tuple(tuple(0.0 for _ in range(6)) for _ in range(6)),
    bending_mm=0.01,
    bending_unaided_mm=0.4,
    bending_aided_mm=0.05,
)
PLACES = Places(
    calibrations=("ab" * 32,),
    water_index=(1.335,),
    places={"000001": PLACE},
    pairs=(ComparedScans("000001", "000002", False, False, "slides", 80.0, None, None),),
    left_out={"000002": "slides"},
    warnings=("look here",),
    shared_error_mm=(0.0,) * 7,
    shared_error_spread_mm=0.02,
    shared_error_aided_mm=0.005,
    shared_error_removed=False,
    variance_factor=1.0,
)
OBJECT = StoredObject("hull 3", (MemberScan("000001", "scans/000001", ("aa", "bb")),), PLACES)


def test_an_object_comes_back_as_it_was_written(tmp_path: Path) -> None:
    objects.write(tmp_path, OBJECT)
    assert objects.read(tmp_path, "hull 3") == OBJECT
    assert objects.names(tmp_path) == ["hull 3"]


def test_adding_scans_forgets_places_that_were_found_without_them(tmp_path: Path) -> None:
    more = objects.with_scans(OBJECT, (MemberScan("000002", "scans/000002", ("cc",)),))
    assert [one.name for one in more.scans] == ["000001", "000002"]
    assert more.places is None


def test_a_scan_is_not_taken_twice_under_whatever_name(tmp_path: Path) -> None:
    with pytest.raises(ObjectError, match="000009 is in it already, as 000001"):
        objects.with_scans(OBJECT, (MemberScan("000009", "copy/000009", ("aa", "bb")),))
    with pytest.raises(ObjectError, match="another scan called 000001"):
        objects.with_scans(OBJECT, (MemberScan("000001", "elsewhere/000001", ("dd",)),))


@pytest.mark.parametrize("name", ["", "../x", "a/b", ".hidden", "x" * 65, "end ", "end."])
def test_names_that_cannot_be_folders_everywhere_are_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(ObjectError, match="allowed are 1 to 64"):
        objects.write(tmp_path, replace(OBJECT, name=name))
    assert not list(tmp_path.iterdir())


def test_an_object_that_is_not_there_names_those_that_are(tmp_path: Path) -> None:
    objects.write(tmp_path, OBJECT)
    with pytest.raises(ObjectError, match=r"object 'reef': there is none .*hull 3"):
        objects.read(tmp_path, "reef")


def test_a_changed_byte_is_noticed(tmp_path: Path) -> None:
    objects.write(tmp_path, OBJECT)
    path = tmp_path / "objects" / "hull 3" / "object.json"
    path.write_text(path.read_text().replace("0.02", "0.03"))
    with pytest.raises(ObjectError, match=r"damaged .*scans are untouched"):
        objects.read(tmp_path, "hull 3")


def test_a_kept_cloud_is_used_only_for_what_it_was_made_from(tmp_path: Path) -> None:
    objects.write(tmp_path, OBJECT)
    points = np.arange(12, dtype=np.float32).reshape(2, 2, 3)
    objects.keep_cloud(tmp_path, "hull 3", "000001", "key", {"points_mm": points})
    kept = objects.kept_cloud(tmp_path, "hull 3", "000001", "key")
    assert kept is not None
    np.testing.assert_array_equal(kept["points_mm"], points)
    assert objects.kept_cloud(tmp_path, "hull 3", "000001", "other key") is None
    path = tmp_path / "objects" / "hull 3" / "clouds" / "000001.npz"
    path.write_bytes(path.read_bytes()[:100])
    assert objects.kept_cloud(tmp_path, "hull 3", "000001", "key") is None, "it is made again"
