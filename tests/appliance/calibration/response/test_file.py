"""A response file comes back as it was written; a changed one is refused and says what to do."""

from __future__ import annotations

import json
import logging
from dataclasses import replace
from pathlib import Path

import pytest

from appliance.calibration.response.file import ResponseFileError, StoredResponse, decode, encode, load
from appliance.config import default_rig_path, load_rig
from appliance.instrument import RESPONSE_FILE, response_of
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
        (resigned(exposure_us=12000.5), "exposure_us is 12000.5; allowed are whole numbers"),
        (resigned(trigger_delay_us=-1), "trigger_delay_us is -1; allowed are whole numbers"),
    ],
)
def test_what_is_no_response_is_refused_with_a_remedy(data: bytes, said: str) -> None:
    with pytest.raises(ResponseFileError, match=r"^here: .*measure") as refused:
        decode(data, "here")
    assert said in str(refused.value)


def test_a_file_that_cannot_be_read_is_no_missing_one(tmp_path: Path) -> None:
    with pytest.raises(ResponseFileError, match="cannot be read"):
        load(tmp_path)


def test_it_says_at_which_exposure_it_was_measured_and_older_files_do_not(tmp_path: Path) -> None:
    assert (STORED.exposure_us, STORED.trigger_delay_us) == (None, None)
    assert b"exposure_us" not in encode(STORED)
    told = replace(STORED, exposure_us=12_000, trigger_delay_us=500)
    assert decode(encode(told), "here") == told


def test_a_response_of_another_trigger_delay_is_not_used_and_of_another_exposure_with_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Bit planes: what begins at another moment of the projector's frame sees other bits."""
    rig = load_rig(default_rig_path())
    rig = replace(rig, storage=replace(rig.storage, root=tmp_path))
    mine = replace(STORED, rig_serial=rig.rig.serial)
    path = tmp_path / RESPONSE_FILE
    path.parent.mkdir()
    used = []
    with caplog.at_level(logging.WARNING, "kingfisher"):
        for stored in (mine, replace(mine, exposure_us=12_000, trigger_delay_us=500)):
            path.write_bytes(encode(stored))
            used.append(response_of(rig))
        assert not caplog.records
        path.write_bytes(encode(replace(mine, exposure_us=8_000, trigger_delay_us=500)))
        used.append(response_of(rig))
        assert "was measured at 8 ms; the rig file's exposure is 12 ms" in caplog.records[-1].getMessage()
        path.write_bytes(encode(replace(mine, exposure_us=12_000, trigger_delay_us=0)))
        used.append(response_of(rig))
        assert "measured with board.trigger_delay_us = 0, not 500" in caplog.records[-1].getMessage()
    assert used == [mine.response, mine.response, mine.response, None]
