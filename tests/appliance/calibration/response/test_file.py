"""A response file comes back as it was written; a changed one is refused and says what to do."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from appliance.calibration.response.file import ResponseFileError, StoredResponse, decode, encode, load
from appliance.patterns.response import Response

STORED = StoredResponse("KF-1", ("000007",), 0.0107, Response((0.45, 0.53, 0.05, -0.02)))


def resigned(**changes: object) -> bytes:
    """A file with another content and the checksum that fits it."""
    import hashlib

    content = {**json.loads(encode(STORED)), **changes}
    content.pop("sha256")
    digest = hashlib.sha256(json.dumps(content, sort_keys=True, separators=(",", ":")).encode()).hexdigest()
    return json.dumps({**content, "sha256": digest}).encode()


def test_it_comes_back_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "response.json"
    assert load(path) is None
    path.write_bytes(encode(STORED))
    assert load(path) == STORED


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (encode(STORED).replace(b"0.53", b"0.54"), "checksum"),
        (encode(STORED)[:40], "not readable as JSON"),
        (b"[]", "a JSON object was expected"),
        (b" " * 70_000, "at most 65536"),
        (resigned(schema=2), "schema 2; this version reads schema 1"),
        (resigned(harmonics=[0.5, "0.5"]), "harmonics must be numbers"),
        (resigned(harmonics=[0.5, -0.5]), "does not grow with the code"),
        (resigned(rig_serial=None), "rig_serial"),
    ],
)
def test_what_is_no_response_is_refused_with_a_remedy(data: bytes, said: str) -> None:
    with pytest.raises(ResponseFileError, match=r"^here: .*measure") as refused:
        decode(data, "here")
    assert said in str(refused.value)


def test_a_file_that_cannot_be_read_is_no_missing_one(tmp_path: Path) -> None:
    with pytest.raises(ResponseFileError, match="cannot be read"):
        load(tmp_path)
