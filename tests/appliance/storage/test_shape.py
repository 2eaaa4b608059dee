"""What a manifest's fields may be: read as pydantic reads them, which is not asked when scans are listed."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest
from pydantic import TypeAdapter, ValidationError

from appliance.scan.exposure import Exposure
from appliance.scan.verdict import Verdict
from appliance.storage.atomic import Stamp
from appliance.storage.manifest import Decision, Manifest, Stage, as_json
from appliance.storage.shape import ShapeError, shaped
from tests.appliance.storage.scenes import record, second_sequence

ORACLE = TypeAdapter(Manifest)
OTHERS: tuple[Any, ...] = (None, True, False, 0, 1, -3, 1.0, 2.5, "x", "", [], {}, [1], {"a": 1}, "kept", "raw", ...)
"""``...``: the key is not there."""


def whole() -> dict[str, Any]:
    """A manifest with something in every field, as JSON has it."""
    verdicts = (Verdict("moved", None, {"shift_px": 1.0, "sigma_px": None}, "text"), Verdict("identity", True))
    complete = record(
        second=second_sequence(), exposure=Exposure(8000, 1.5), verdicts=verdicts, cloud={"points": 20, "noise_mm": 0.5}
    )
    manifest = Manifest(
        "000001", Stage.RAW, Decision.KEPT, complete, {"f": Stamp(3, "ab")}, frame_crc32={"f": ("1", "2")}
    )
    read: dict[str, Any] = json.loads(json.dumps(as_json(manifest)))
    del read["schema"]
    return read


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


def by_oracle(content: dict[str, Any]) -> str | None:
    try:
        return repr(ORACLE.validate_python(content))
    except ValidationError:
        return None


def by_us(content: dict[str, Any]) -> str | None:
    try:
        return repr(shaped(Manifest, content))
    except ShapeError:
        return None


def test_a_whole_manifest_is_read_field_by_field_with_the_same_types() -> None:
    assert by_us(whole()) == by_oracle(whole()) is not None


@pytest.mark.parametrize("other", OTHERS, ids=repr)
def test_every_field_with_something_else_in_it_is_read_or_refused_as_by_pydantic(other: Any) -> None:
    wrong = [path for path in places(whole()) if by_us(changed(path, other)) != by_oracle(changed(path, other))]
    assert wrong == []


def test_the_first_wrong_field_is_named_with_what_is_expected() -> None:
    for path, other, said in (
        (("record", "exposure", "time_us"), 1.5, "record.exposure.time_us: a whole number is expected, not 1.5"),
        (("record", "verdicts", 0, "name"), 3, "record.verdicts.0.name: a text is expected, not 3"),
        (("record", "rig_hash"), ..., "record.rig_hash: missing"),
        (("stage",), "cooked", "stage: 'raw' or 'complete' is expected, not 'cooked'"),
        (("files",), [], "files: an object is expected, not []"),
    ):
        with pytest.raises(ShapeError) as error:
            shaped(Manifest, changed(path, other))
        assert str(error.value) == said


@pytest.mark.parametrize(
    ("field", "number"), [("gain_db", 10**400), ("time_us", float("inf")), ("time_us", float("nan"))]
)
def test_a_number_without_end_is_refused_and_no_crash(field: str, number: float) -> None:
    with pytest.raises(ShapeError, match=rf"^record\.exposure\.{field}: a number is expected"):
        shaped(Manifest, changed(("record", "exposure", field), number))
