"""Owns the file of the projector's response: small, checksummed, readable JSON, beside the calibration."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path

from appliance.calibration.measured_file import MeasuredFile, MeasuredFileError
from appliance.checksummed_file import is_number, with_checksum
from appliance.patterns.response import HIGHEST_ORDER, Response

SCHEMA = 1


class ResponseFileError(MeasuredFileError):
    """A response file cannot be used; the text says which, why and what to do."""


_KIND = MeasuredFile(
    "response",
    SCHEMA,
    "measure the response again, or remove the file: patterns are then drawn without compensation",
    ResponseFileError,
)


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

    wrong, content = partial(_KIND.wrong, name), _KIND.content(data, name)
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
    found = _KIND.data(path)
    return None if found is None else decode(*found)
