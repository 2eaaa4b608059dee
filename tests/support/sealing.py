"""Seals and opens small files of the instrument by their written form: JSON with ``sha256`` of the compact form of everything else."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any


def sealed(content: Mapping[str, Any], indent: int | None = 2) -> bytes:
    """A file with a checksum that fits, whatever there is to seal."""
    content = {key: value for key, value in content.items() if key != "sha256"}
    digest = hashlib.sha256(json.dumps(content, sort_keys=True, separators=(",", ":")).encode()).hexdigest()
    return (json.dumps({**content, "sha256": digest}, sort_keys=True, indent=indent) + "\n").encode()


def opened(data: bytes) -> dict[str, Any]:
    """The content of a sealed file without its checksum, which must fit."""
    content: dict[str, Any] = json.loads(data)
    assert json.loads(sealed(content)) == content, "its checksum does not fit"
    del content["sha256"]
    return content
