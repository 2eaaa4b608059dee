"""Owns what the rig file may say about finding the key pad."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class KeysSpec:
    """The key pad of the rig, by USB identity."""

    vendor_id: int
    product_id: int
    name: str = "keys"
