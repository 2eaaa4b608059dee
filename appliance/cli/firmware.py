"""Owns the verbs ``firmware``: the files of one instrument's trigger board and key pad, laid out to be copied onto them."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from appliance.cli.arguments import option
from appliance.cli.desk import writing
from appliance.cli.output import Exit, UsageError, say, say_json
from appliance.cli.places import WithRig
from appliance.store import LocalFileSystem, make_folders, move_folder, replace_file

if TYPE_CHECKING:  # brings pydantic, which `--help` can do without
    from appliance.workshop import Part


@dataclass(frozen=True, slots=True, kw_only=True)
class _LayOut(WithRig):
    """A verb that lays out one firmware."""

    kernels: ClassVar[bool] = False
    part: ClassVar[Part]

    out: Path | None = option("--out", "default: build/board or build/keys", parse=Path, metavar="FOLDER")

    def run(self) -> Exit:
        rig = self.read_rig()
        from appliance.workshop import commands, instrument_values, laid_out

        folder = self.out or Path("build") / self.part
        files = laid_out(self.part, rig)
        _check(folder, files)
        with writing(folder):
            _write(folder, files)
        values, typed = instrument_values(self.part, rig), commands(self.part, folder)
        if self.json:
            say_json({"folder": str(folder), "files": sorted(files), "instrument": values, "commands": list(typed)})
            return Exit.OK
        say(f"{len(files)} files in {folder}; USB identity {values['VENDOR']:04x}:{values['PRODUCT']:04x}")
        if "SYNC_RISES" in values:
            mode = f"{rig.projector.width_px}x{rig.projector.height_px} at {rig.projector.refresh_hz:g} Hz"
            say(f"the sync of {mode} begins with a {'rising' if values['SYNC_RISES'] else 'falling'} edge")
        say("with MicroPython on the module and SERVICE to ground:")
        for command in typed:
            say(f"    {command}")
        return Exit.OK


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardFirmware(_LayOut):
    """Lay out the trigger board's firmware for the instrument of a rig file: USB identity, and which way its sync goes."""

    part: ClassVar[Part] = "board"


@dataclass(frozen=True, slots=True, kw_only=True)
class KeysFirmware(_LayOut):
    """Lay out the key pad's firmware for the instrument of a rig file: its USB identity."""

    part: ClassVar[Part] = "keys"


def _check(folder: Path, files: dict[str, bytes]) -> None:
    """Refuse a folder with anything of another origin: it is replaced as a whole. Raises UsageError."""
    if folder.exists() and not folder.is_dir():
        raise UsageError(f"--out {folder}: is a file; give a folder, which is made if it is not there")
    there = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if not path.is_dir()}
    if strange := sorted(there - files.keys()):
        raise UsageError(f"--out {folder}: holds {strange[0]}, which is not of this firmware; give an empty folder")


def _write(folder: Path, files: dict[str, bytes]) -> None:
    fs, draft = LocalFileSystem(), folder.with_name(f".{folder.name}.draft")
    shutil.rmtree(draft, ignore_errors=True)
    for name, content in files.items():
        make_folders(fs, (draft / name).parent)
        replace_file(fs, draft / name, content)
    # Whole or not at all: half a firmware would be copied like a whole one.
    if folder.exists():
        old = folder.with_name(f".{folder.name}.old")
        shutil.rmtree(old, ignore_errors=True)
        move_folder(fs, folder, old)
        move_folder(fs, draft, folder)
        shutil.rmtree(old)
    else:
        move_folder(fs, draft, folder)
