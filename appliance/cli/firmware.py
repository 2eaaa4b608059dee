"""The verb ``setup firmware``: the files of one instrument's trigger board and key pad, laid out to be copied onto them."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from appliance.cli.arguments import operand, option
from appliance.cli.desk import new_folder, writing
from appliance.cli.output import Exit, UsageError
from appliance.cli.places import WithRig
from appliance.store import LocalFileSystem, make_folders, move_folder, replace_file

if TYPE_CHECKING:  # brings pydantic, which `--help` can do without
    from appliance.workshop import Part


@dataclass(frozen=True, slots=True, kw_only=True)
class LayOutFirmware(WithRig):
    """Lay out the firmware of the trigger board or the key pad for the instrument of a rig file: its USB identity, and which way its sync goes."""

    kernels: ClassVar[bool] = False

    part: Part = operand("PART", "board or keys", choices=("board", "keys"))
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
        lines = [f"{len(files)} files in {folder}; USB identity {values['VENDOR']:04x}:{values['PRODUCT']:04x}"]
        if "SYNC_RISES" in values:
            mode = f"{rig.projector.width_px}x{rig.projector.height_px} at {rig.projector.refresh_hz:g} Hz"
            lines.append(f"the sync of {mode} begins with a {'rising' if values['SYNC_RISES'] else 'falling'} edge")
        lines.append("with MicroPython on the module and SERVICE to ground:")
        self.tell(
            {"folder": str(folder), "files": sorted(files), "instrument": values, "commands": list(typed)},
            [*lines, *(f"    {command}" for command in typed)],
        )
        return Exit.OK


def _check(folder: Path, files: dict[str, bytes]) -> None:
    """Refuse a folder with anything of another origin: it is replaced as a whole. Raises UsageError."""
    new_folder(folder)
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
