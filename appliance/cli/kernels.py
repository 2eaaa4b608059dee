"""Kernels are found before a verb that needs them, or compiled; and the verb ``setup compile``.

What is waited for is said on stderr, how much and for how long: on a terminal in one line that changes, elsewhere in
lines at most ten seconds apart."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import ClassVar, TextIO

from appliance.base import (
    CompileError,
    Compiling,
    KernelCache,
    KernelOrigin,
    Piece,
    compile_pieces,
    importing,
    missing_kernels,
    use_kernel_cache,
)
from appliance.cli import output
from appliance.cli.arguments import Verb, path_option, switch
from appliance.cli.output import Exit, ProgressLine, UsageError

log = logging.getLogger(__name__)
service_log = logging.getLogger("kingfisher")


def find_kernels() -> None:
    """Use what was compiled before. What was not is compiled when it is first needed: only that is worth a line."""
    cache = use_kernel_cache()
    level = logging.INFO if cache.origin is KernelOrigin.EMPTY else logging.DEBUG
    service_log.log(level, "kernels: %s, in %s", cache.origin.value, cache.path)


def compile_kernels(more: Callable[[], Iterable[tuple[str, str]]] = tuple) -> None:
    """Have everything compiled that a scan needs, recorded or stored, and the pieces (what for, function) of
    ``more``."""
    cache = use_kernel_cache()  # before numba is imported
    with importing():
        from appliance.measure import PIECES

        pieces = (*PIECES, *(Piece(what, function) for what, function in more()))
    _compile(cache, pieces)


def compile_point_kernels() -> None:
    """Have compiled what makes points of coordinates, without anything that judges a scan: most of what imported images
    need."""
    cache = use_kernel_cache()
    with importing():
        from appliance.measure import POINT_PIECES
    _compile(cache, POINT_PIECES)


def _compile(cache: KernelCache, pieces: Sequence[Piece]) -> None:
    # Whoever set NUMBA_CACHE_DIR keeps that folder up to date (ADR 0019).
    if cache.origin is KernelOrigin.GIVEN or not missing_kernels(cache.path, pieces):
        return
    try:
        with CompileProgress() as progress:
            compile_pieces(cache.path, pieces, progress)
    except (CompileError, OSError) as error:
        log.warning("kernels could not be compiled in advance: %s; they are compiled when first needed", error)


class CompileProgress:
    """Says how far the compiler is, from its beginning on. A context manager; call it with each ``Compiling``."""

    def __init__(self, stream: TextIO | None = None, line: Callable[[str], None] = output.log.info) -> None:
        self._line = line
        self._last = Compiling(0, 0, (), 0.0)
        self._begun = False
        self._progress = ProgressLine(stream, lambda: self._last.seconds, line, after_s=(0.0, 0.0))

    def __call__(self, now: Compiling) -> None:
        self._last, self._begun = now, True
        self._progress(_sentence(now))

    def __enter__(self) -> CompileProgress:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._progress.__exit__()
        if self._begun and kind is None:
            self._line(f"compiled in {self._last.seconds:.0f} s")


def _sentence(now: Compiling) -> str:
    # Nobody here compiles anything then: the lock is another process's.
    if not now.what:
        return f"another process is compiling the same kernels; waiting for it, {now.seconds:.0f} s"
    return f"compiling, once: {now.done} of {now.total} done; {', '.join(now.what)}; {now.seconds:.0f} s"


@dataclass(frozen=True, slots=True, kw_only=True)
class CompileKernels(Verb):
    """Compile the kernels for this processor, or for the common level, as an installation does."""

    kernels: ClassVar[bool] = False

    out: Path | None = path_option("--out", "default: within the installed environment", metavar="DIR")
    common: bool = switch("--common", "for every x86-64-v3 processor instead of this one: for images")

    def run(self) -> Exit:
        from appliance.base import COMMON_KERNELS, build_kernels, shipped_kernels
        from appliance.cli.desk import new_folder
        from appliance.store import StorageError

        target = self.out or shipped_kernels()
        new_folder(target)
        from appliance.measure import PIECES

        with CompileProgress() as progress:
            try:
                folder = build_kernels(target, PIECES, progress, COMMON_KERNELS if self.common else None)
            except OSError as error:
                refusal = StorageError.of("cannot write", target, error)
                raise UsageError(f"{target}: {refusal.reason}; {refusal.remedy}; --out DIR writes elsewhere") from error
        self.tell({"folder": str(folder)}, [f"kernels are in {folder}"])
        return Exit.OK
