"""Owns the file of the cameras' measured noise: small, checksummed, readable JSON, beside the calibration."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path

from appliance.calibration.measured_file import MeasuredFile, MeasuredFileError
from appliance.checksummed_file import is_number, with_checksum
from appliance.scan.sides import SIDES

SCHEMA = 1
LIMITS = {"full_well_e": (500.0, 9e5), "read_noise_e": (0.0, 900.0), "black_level_dn": (0.0, 63.0)}
"""Range of each figure, within that of the rig file's key of the same name."""


class NoiseFileError(MeasuredFileError):
    """A file of noise cannot be used; the text says which, why and what to do."""


_KIND = MeasuredFile(
    "noise",
    SCHEMA,
    "measure the noise again, or remove the file: the rig file's data sheets are then believed",
    NoiseFileError,
)


@dataclass(frozen=True, slots=True)
class CameraFigures:
    """One camera's figures as the rig file has them, measured instead of read in a data sheet."""

    serial: str
    """The camera's serial number: another one has another noise."""
    full_well_e: float
    """Electrons at 255 grey values and 0 dB."""
    read_noise_e: float
    """All noise that does not depend on light, but rounding to grey values."""
    black_level_dn: float
    """Grey value of no light."""


@dataclass(frozen=True, slots=True)
class StoredNoise:
    """The noise of both cameras and where it comes from."""

    rig_serial: str
    made_from: tuple[str, ...]
    """Ids of the scans."""
    left: CameraFigures
    right: CameraFigures


def encode(stored: StoredNoise) -> bytes:
    """Return the file's bytes: JSON with sorted keys; ``sha256`` is that of the compact form of everything else."""
    cameras = {
        side: {"serial": one.serial, **{name: getattr(one, name) for name in LIMITS}}
        for side, one in zip(SIDES, (stored.left, stored.right), strict=True)
    }
    return with_checksum(
        {
            "schema": SCHEMA,
            "rig_serial": stored.rig_serial,
            "made_from": list(stored.made_from),
            "cameras": cameras,
        }
    )


def decode(data: bytes, name: str) -> StoredNoise:
    """Parse and check a file's bytes. Raises NoiseFileError naming ``name``, what is wrong and the remedy."""

    wrong, content = partial(_KIND.wrong, name), _KIND.content(data, name)
    serial, sources, cameras = content.get("rig_serial"), content.get("made_from"), content.get("cameras")
    if not isinstance(serial, str) or not isinstance(sources, list) or not isinstance(cameras, dict):
        raise wrong("rig_serial, made_from or cameras is missing")
    found = []
    for side in SIDES:
        one = cameras.get(side)
        if not isinstance(one, dict) or not isinstance(one.get("serial"), str):
            raise wrong(f"cameras.{side} or its serial is missing")
        for key, (lowest, highest) in LIMITS.items():
            value = one.get(key)
            if not is_number(value) or not lowest <= value <= highest:
                raise wrong(f"cameras.{side}.{key} is {value!r:.40}; allowed are {lowest:g}..{highest:g}")
        found.append(CameraFigures(one["serial"], **{key: float(one[key]) for key in LIMITS}))
    return StoredNoise(serial, tuple(str(source) for source in sources), *found)


def load(path: Path) -> StoredNoise | None:
    """Read a file of noise; ``None`` where there is none. Raises NoiseFileError."""
    found = _KIND.data(path)
    return None if found is None else decode(*found)
