"""What was sealed comes back; what was changed, cut or never sealed is refused with the reason."""

from __future__ import annotations

import pytest

from appliance.checksummed_file import ChecksumError, checked_content, with_checksum

CONTENT = {"b": [1.5, "µm"], "a": {"deep": None}}


@pytest.mark.parametrize("indent", [None, 2])
def test_what_was_sealed_comes_back_whatever_its_layout(indent: int | None) -> None:
    assert checked_content(with_checksum(CONTENT, indent), 1000) == CONTENT


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (with_checksum(CONTENT).replace(b"1.5", b"1.6"), "changed or damaged"),
        (with_checksum(CONTENT)[:-9], "not readable as JSON"),
        (b'{"a": 1}', "changed or damaged"),
        (b"[]", "a JSON object was expected, not list"),
        (b"[" * 900, "not readable as JSON"),
        (b"\xff", "not readable as JSON"),
        (b" " * 1001, "at most 1000 are allowed"),
    ],
)
def test_anything_else_is_refused_with_the_reason(data: bytes, reason: str) -> None:
    with pytest.raises(ChecksumError, match=reason):
        checked_content(data, 1000)
