"""Owns which of the pinned packages an instrument needs: what runs there, without the tools that the program is made with."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

from kingfisher_setup.errors import SetupError

_PIN = re.compile(r"^([A-Za-z0-9][A-Za-z0-9._-]*)==")


def runtime_pins(tree: Path) -> str:
    """Those pins of ``requirements.lock`` that follow from what the project states it needs, with their hashes.

    The lock names after each pin the packages that want it (``# via``); from the project's own needs, and what its
    build needs, all others are reached. Raises SetupError where the two files do not belong together.
    """
    try:
        project = tomllib.loads((tree / "pyproject.toml").read_text(encoding="utf-8"))
        lock = (tree / "requirements.lock").read_text(encoding="utf-8")
    except OSError as error:
        raise SetupError(f"{error.filename}: {error.strerror}; run the setup from a complete source tree") from error
    wanted = {_name(need) for need in (*project["project"]["dependencies"], *project["build-system"]["requires"])}
    blocks = dict(_blocks(lock))
    missing = sorted(wanted - set(blocks))
    if missing:
        raise SetupError(f"requirements.lock does not pin {', '.join(missing)}; make it anew with `./dev lock`")
    while more := {name for name, text in blocks.items() if name not in wanted and wanted & _wanted_by(text)}:
        wanted |= more
    return "".join(text for name, text in blocks.items() if name in wanted)


def _name(requirement: str) -> str:
    return _canonical(re.split(r"[^A-Za-z0-9._-]", requirement.strip(), maxsplit=1)[0])


def _canonical(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def _blocks(lock: str) -> Iterator[tuple[str, str]]:
    """Each package's lines, by its name; those before the first one's by none."""
    name, lines = "", list[str]()
    for line in lock.splitlines(keepends=True):
        if found := _PIN.match(line):
            yield name, "".join(lines)
            name, lines = _canonical(found[1]), []
        lines.append(line)
    yield name, "".join(lines)


def _wanted_by(block: str) -> set[str]:
    """``# via numba`` or a list of such lines."""
    after = block.partition("# via")[2]
    return {_canonical(line.strip(" #").split(" ")[0]) for line in after.splitlines()} - {""}
