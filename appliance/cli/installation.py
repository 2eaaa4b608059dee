"""Owns the verbs ``version`` and ``warm``: what is installed here, and the kernels that an installation brings."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from appliance import __version__
from appliance.base import other_program
from appliance.cli.arguments import Verb, option, switch
from appliance.cli.output import Exit, UsageError, complain, say, say_json


@dataclass(frozen=True, slots=True, kw_only=True)
class Version(Verb):
    """The program's version."""

    kernels: ClassVar[bool] = False

    def run(self) -> Exit:
        other = other_program()
        if self.json:
            say_json({"version": __version__, "other_program": other})
        else:
            say(f"kingfisher {__version__}")
            if other is not None:
                complain(other, as_json=False)
        return Exit.OK


@dataclass(frozen=True, slots=True, kw_only=True)
class Warm(Verb):
    """Compile the kernels for this processor, or for the common level, as an installation does."""

    kernels: ClassVar[bool] = False

    out: Path | None = option("--out", "default: within the installed environment", parse=Path, metavar="DIR")
    common: bool = switch("--common", "for every x86-64-v3 processor instead of this one: for images")

    def run(self) -> Exit:
        from appliance.base import COMMON_KERNELS, build_kernels, shipped_kernels
        from appliance.cli.kernels import CompileProgress
        from appliance.store import remedy_for

        target = self.out or shipped_kernels()
        if target.exists() and not target.is_dir():
            raise UsageError(f"--out {target}: is a file; give a folder, which is made if it is not there")
        from appliance.measure import PIECES

        with CompileProgress() as progress:
            try:
                folder = build_kernels(target, PIECES, progress, COMMON_KERNELS if self.common else None)
            except OSError as error:
                raise UsageError(
                    f"{target}: {error.strerror or error}; {remedy_for(error)}; --out DIR writes elsewhere"
                ) from error
        if self.json:
            say_json({"folder": str(folder)})
        else:
            say(f"kernels are in {folder}")
        return Exit.OK
