"""Owns what a piece of work asks of the ``os`` module about durability: its fsync and rename calls, in their order, with paths."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest


@dataclass(frozen=True)
class Call:
    """One call. ``path`` is that of the descriptor, or the old name; ``target`` the new one of a rename."""

    name: str
    path: Path
    target: Path | None = None


def seen_by_python(work: Callable[[], None]) -> list[Call]:
    """Run ``work`` and return what it asked of the ``os`` module, each call carried out."""
    calls: list[Call] = []
    fsync, fdatasync, rename, replace = os.fsync, os.fdatasync, os.rename, os.replace

    def noted_fsync(descriptor: int) -> None:
        calls.append(Call("fsync", Path(f"/proc/self/fd/{descriptor}").readlink()))
        fsync(descriptor)

    def noted_fdatasync(descriptor: int) -> None:
        calls.append(Call("fdatasync", Path(f"/proc/self/fd/{descriptor}").readlink()))
        fdatasync(descriptor)

    def noted_rename(source: Path, target: Path) -> None:
        calls.append(Call("rename", Path(source), Path(target)))
        rename(source, target)

    def noted_replace(source: Path, target: Path) -> None:
        calls.append(Call("rename", Path(source), Path(target)))
        replace(source, target)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", noted_fsync)
        patch.setattr(os, "fdatasync", noted_fdatasync)
        patch.setattr(os, "rename", noted_rename)
        patch.setattr(os, "replace", noted_replace)
        work()
    return calls
