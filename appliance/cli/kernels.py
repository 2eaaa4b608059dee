"""Compiled kernels for the verbs that need them, and the verb ``setup compile``.

Waiting times are reported on stderr: on a terminal in one changing line, elsewhere in lines at most ten seconds apart.
"""

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
    """Use the kernels that are already compiled; others are compiled at their first call, which is logged."""
    cache = use_kernel_cache()
    level = logging.INFO if cache.origin is KernelOrigin.EMPTY else logging.DEBUG
    service_log.log(level, "kernels: %s, in %s", cache.origin.value, cache.path)


def compile_kernels(more: Callable[[], Iterable[tuple[str, str]]] = tuple) -> None:
    """Compile all kernels that a scan needs, recorded or stored, and the pieces (text, function) of ``more``."""
    cache = use_kernel_cache()  # before numba is imported
    with importing():
        from appliance.measure import PIECES

        pieces = (*PIECES, *(Piece(text, function) for text, function in more()))
    _compile(cache, pieces)


def compile_point_kernels() -> None:
    """Compile the kernels from coordinates to points, without those of judges: most of an import."""
    cache = use_kernel_cache()
    with importing():
        from appliance.measure import POINT_PIECES
    _compile(cache, POINT_PIECES)


def _compile(cache: KernelCache, pieces: Sequence[Piece]) -> None:
    # The owner of NUMBA_CACHE_DIR keeps that folder up to date (ADR 0019).
    if cache.origin is KernelOrigin.GIVEN or not missing_kernels(cache.path, pieces):
        return
    try:
        with CompileProgress() as progress:
            compile_pieces(cache.path, pieces, progress)
    except (CompileError, OSError) as error:
        log.warning("kernels could not be compiled in advance: %s; they are compiled when first needed", error)


class CompileProgress:
    """Progress of the compiler from its beginning. A context manager; call it with each ``Compiling``."""

    def __init__(self, stream: TextIO | None = None, line: Callable[[str], None] = output.log.info) -> None:
        self._line = line
        self._last = Compiling(0, 0, (), 0.0)
        self._begun = False
        self._progress = ProgressLine(stream, lambda: self._last.seconds, line, after_s=(0.0, 0.0))

    def __call__(self, state: Compiling) -> None:
        self._last, self._begun = state, True
        self._progress(_sentence(state))

    def __enter__(self) -> CompileProgress:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._progress.__exit__()
        if self._begun and kind is None:
            self._line(f"compiled in {self._last.seconds:.0f} s")


def _sentence(state: Compiling) -> str:
    # Then another process has the lock and compiles.
    if not state.what:
        return f"another process is compiling the same kernels; waiting for it, {state.seconds:.0f} s"
    return f"compiling, once: {state.done} of {state.total} done; {', '.join(state.what)}; {state.seconds:.0f} s"


@dataclass(frozen=True, slots=True, kw_only=True)
class CompileKernels(Verb):
    """Compile the kernels for this processor, or for the common level, as an installation does."""

    kernels: ClassVar[bool] = False

    out: Path | None = path_option("--out", "default: within the installed environment", metavar="DIR")
    common: bool = switch("--common", "for every x86-64-v3 processor instead of this one, for disk images")

    def run(self) -> Exit:
        from appliance.base import COMMON_KERNELS, build_kernels, shipped_kernels
        from appliance.cli.desk import check_new_folder
        from appliance.store import StorageError

        target = self.out or shipped_kernels()
        check_new_folder(target)
        from appliance.measure import PIECES

        with CompileProgress() as progress:
            try:
                folder = build_kernels(target, PIECES, progress, COMMON_KERNELS if self.common else None)
            except OSError as error:
                refusal = StorageError.of("cannot write", target, error)
                raise UsageError(f"{target}: {refusal.reason}; {refusal.remedy}; --out DIR writes elsewhere") from error
        self.tell({"folder": str(folder)}, [f"kernels are in {folder}"])
        return Exit.OK
