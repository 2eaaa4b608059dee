"""Owns how a file or a link changes so that the loss of power leaves the old or the new one, whole."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
from pathlib import Path
from typing import Any


def sync_folder(path: Path) -> None:
    """Make the names in ``path`` durable."""
    descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def make_folder(path: Path) -> None:
    """Make a folder and those above it that are missing, each durable before the next."""
    for one in reversed([one for one in (path, *path.parents) if not one.is_dir()]):
        one.mkdir(exist_ok=True)
        sync_folder(one.parent)


def publish(draft: Path, path: Path) -> None:
    """Give a file that is written its name, in place of the one that has it; content first, then the name."""
    with draft.open("rb") as file:
        os.fsync(file.fileno())  # through any descriptor of a file: its content is durable, whoever wrote it
    draft.replace(path)
    sync_folder(path.parent)


def write(path: Path, content: bytes, mode: int = 0o644) -> None:
    """Replace (or make) a file. A file that has this content already is left alone."""
    with contextlib.suppress(OSError):
        if path.read_bytes() == content and not path.is_symlink():
            return
    make_folder(path.parent)
    draft = path.with_name(f".{path.name}.draft")
    draft.unlink(missing_ok=True)
    with open(os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "wb") as file:  # noqa: PTH123
        file.write(content)
    draft.chmod(mode)  # whatever the umask
    publish(draft, path)


def write_json(path: Path, content: dict[str, Any]) -> None:
    write(path, json.dumps(content, indent=1).encode() + b"\n")


def read_json(path: Path) -> dict[str, Any] | None:
    """The file's object; ``None`` where there is no file, or none that is one. Follows no link; reads 64 KB at most."""
    try:
        with open(os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK), "rb") as file:  # noqa: PTH123
            content = json.loads(file.read(1 << 16))
    except (OSError, ValueError, RecursionError):
        return None
    return content if isinstance(content, dict) else None


def point(link: Path, target: str) -> None:
    """Let ``link`` lead to ``target``, at once and durably."""
    if link.is_symlink() and os.readlink(link) == target:  # noqa: PTH115
        return
    make_folder(link.parent)
    draft = link.with_name(f".{link.name}.draft")
    draft.unlink(missing_ok=True)
    draft.symlink_to(target)
    draft.replace(link)
    sync_folder(link.parent)


def remove(path: Path) -> None:
    """Take away a file or a link, if it is there."""
    if path.is_symlink() or path.exists():
        path.unlink()
        sync_folder(path.parent)


def remove_tree(path: Path) -> None:
    """Take away a folder, if it is there."""
    if path.exists():
        shutil.rmtree(path)
        sync_folder(path.parent)
