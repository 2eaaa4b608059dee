"""Owns the file of the projector's response: small, checksummed, readable JSON, beside the calibration."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from appliance.checksummed_file import ChecksumError, checked_content, is_number, with_checksum
from appliance.patterns.response import HIGHEST_ORDER, Response

SCHEMA = 1
MAX_BYTES = 64 * 1024
_REMEDY = "measure the response again, or remove the file: patterns are then drawn without compensation"


class ResponseFileError(Exception):
    """A response file cannot be used; the text says which, why and what to do."""


@dataclass(frozen=True, slots=True)
class StoredResponse:
    """A response and where it comes from."""

    rig_serial: str
    made_from: tuple[str, ...]
    """Ids of the scans."""
    residual: float
    """RMS of what was seen against the response, as a fraction of the bright light."""
    response: Response
    exposure_us: int | None = None
    """Exposure that it was measured with: a projector of bit planes has another one for each. ``None``: not known."""
    trigger_delay_us: int | None = None
    """Time from the vertical sync to the beginning of that exposure; ``None``: not known."""


def encode(stored: StoredResponse) -> bytes:
    """Return the file's bytes: JSON with sorted keys; ``sha256`` is that of the compact form of everything else."""
    content = {
        "schema": SCHEMA,
        "rig_serial": stored.rig_serial,
        "made_from": list(stored.made_from),
        "residual": stored.residual,
        "harmonics": list(stored.response.harmonics),
    }
    taken = {"exposure_us": stored.exposure_us, "trigger_delay_us": stored.trigger_delay_us}
    return with_checksum(content | {key: value for key, value in taken.items() if value is not None})


def decode(data: bytes, name: str) -> StoredResponse:
    """Parse and check a file's bytes. Raises ResponseFileError naming ``name``, what is wrong and the remedy."""

    def wrong(what: str) -> ResponseFileError:
        return ResponseFileError(f"{name}: {what}; {_REMEDY}")

    try:
        content = checked_content(data, MAX_BYTES)
    except ChecksumError as error:
        raise wrong(str(error)) from error
    if content.get("schema") != SCHEMA:
        raise wrong(f"schema {content.get('schema')!r:.40}; this version reads schema {SCHEMA}")
    serial, sources = content.get("rig_serial"), content.get("made_from")
    if not isinstance(serial, str) or not isinstance(sources, list):
        raise wrong("rig_serial or made_from is missing")
    residual, harmonics = content.get("residual"), content.get("harmonics")
    if not is_number(residual) or not isinstance(harmonics, list) or not all(is_number(b) for b in harmonics):
        raise wrong(f"residual and harmonics must be numbers, of the latter at most {HIGHEST_ORDER + 1}")
    if len(harmonics) > HIGHEST_ORDER + 1:
        raise wrong(f"{len(harmonics)} harmonics; at most {HIGHEST_ORDER + 1} are allowed")
    taken_us = []
    for key in ("exposure_us", "trigger_delay_us"):
        value = content.get(key)
        if value is not None and (not is_number(value) or not isinstance(value, int) or value < 0):
            raise wrong(f"{key} is {value!r:.40}; allowed are whole numbers from 0")
        taken_us.append(value)
    try:
        response = Response(tuple(float(b) for b in harmonics))
    except ValueError as error:
        raise ResponseFileError(f"{name}: {error}") from error
    return StoredResponse(serial, tuple(str(source) for source in sources), float(residual), response, *taken_us)


def load(path: Path) -> StoredResponse | None:
    """Read a response file; ``None`` where there is none. Raises ResponseFileError."""
    try:
        return decode(path.read_bytes(), f"response {path}")
    except FileNotFoundError:
        return None
    except OSError as error:
        raise ResponseFileError(f"response {path}: cannot be read ({error.strerror}); {_REMEDY}") from error
