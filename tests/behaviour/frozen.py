"""Reads and writes what was frozen, and compares clouds with it.

``python -m tests.behaviour.frozen`` freezes anew what this version makes of the recordings.
"""

from __future__ import annotations

import io
import json
import os
import platform
import tarfile
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numpy as np
from numpy.typing import NDArray

from tests.behaviour.outcomes import differences, outcome_of

RECORDINGS = Path(__file__).with_name("recordings.tar.xz")
FROZEN = Path(__file__).with_name("frozen.tar.xz")
MOST_PIXELS = 5
MOST_MM, MOST_FILE_MM = 1e-4, 0.01
"""On another processor: pixels that are in one of two clouds only, and distance of a point from itself, in clouds of ours and in files."""
MOST_SIGMA = 1e-3
SHARES = {True: 1e-5, False: 1e-3}
"""Largest change of a number of documents, on the processor that froze and on another one; threads of solvers change what is below."""
Arrays = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class Frozen:
    """Documents and clouds by name, and the processor on which they were made."""

    processor: str
    said: dict[str, Any]
    clouds: dict[str, Arrays]


def processor() -> str:
    """Return what decides which instructions compute: two equal ones give the same bytes."""
    chosen = [os.environ.get(name, "") for name in ("NUMBA_CPU_NAME", "OPENBLAS_CORETYPE")]
    return " ".join(filter(None, (platform.machine(), llvm.get_host_cpu_name(), *chosen)))


@lru_cache
def frozen() -> Frozen:
    """Return what was frozen."""
    with tarfile.open(FROZEN) as packed:
        files = {one.name: packed.extractfile(one) for one in packed.getmembers()}
        said = json.load(files["said.json"])  # type: ignore[arg-type]
        clouds: dict[str, dict[str, NDArray[Any]]] = {}
        for name, file in files.items():
            if name.endswith(".npy") and file is not None:
                cloud, _, array = name.removesuffix(".npy").partition("|")
                clouds.setdefault(cloud, {})[array] = np.load(io.BytesIO(file.read()))
    return Frozen(said["processor"], said["said"], {**{name: {} for name in said["clouds"]}, **clouds})


def cloud_differences(wanted: Arrays, found: Arrays, exact: bool) -> Iterator[str]:
    """Yield where two clouds differ: in any byte if ``exact``, else in what another processor may not change."""
    if set(wanted) != set(found):
        yield f"arrays {sorted(wanted)} became {sorted(found)}"
        return
    for name in wanted if exact else ():
        if wanted[name].shape != found[name].shape or wanted[name].tobytes() != found[name].tobytes():
            yield f"{name} {wanted[name].shape} became {found[name].shape}, or other bytes"
    if exact or not wanted:
        return
    if "pixel" not in wanted:
        yield from _file_differences(wanted, found)
        return
    both, a, b = np.intersect1d(wanted["pixel"], found["pixel"], return_indices=True)
    alone = len(wanted["pixel"]) + len(found["pixel"]) - 2 * len(both)
    if alone > MOST_PIXELS:
        yield f"{alone} pixels are in one of them only"
    apart_mm = np.abs(wanted["points_mm"][a].astype(float) - found["points_mm"][b]).max(initial=0.0)
    if apart_mm > MOST_MM:
        yield f"a point moved by {apart_mm} mm"
    worse = np.abs(wanted["sigma_mm"][a] / found["sigma_mm"][b] - 1.0).max(initial=0.0)
    if worse > MOST_SIGMA:
        yield f"a sigma changed by a share of {worse}"


def _file_differences(wanted: Arrays, found: Arrays) -> Iterator[str]:
    more = abs(len(wanted["x"]) - len(found["x"]))
    if more > MOST_PIXELS:
        yield f"{more} points more or fewer"
    for name in "xyz" if not more else "":
        apart_mm = np.abs(wanted[name].astype(float) - found[name]).max(initial=0.0)
        if apart_mm > MOST_FILE_MM:
            yield f"a point moved by {apart_mm} mm along {name}"


def freeze() -> None:
    """Freeze what this version makes of the recordings, and print what became another."""
    with tempfile.TemporaryDirectory() as name:
        with tarfile.open(RECORDINGS) as packed:
            packed.extractall(name, filter="data")
        os.chdir(name)
        outcome = outcome_of(Path(name))
    document = {"processor": processor(), "clouds": sorted(outcome.clouds), "said": outcome.said}
    document = json.loads(json.dumps(document))
    if FROZEN.exists():
        before = frozen()
        for line in differences(before.said, document["said"], SHARES[True]):
            print(line[:400])
        for cloud in sorted(set(before.clouds) | set(outcome.clouds)):
            for line in cloud_differences(before.clouds.get(cloud, {}), outcome.clouds.get(cloud, {}), exact=True):
                print(f"{cloud}: {line}")
    parts = {"said.json": json.dumps(document, indent=1).encode()}
    for cloud, arrays in sorted(outcome.clouds.items()):
        for array, values in sorted(arrays.items()):
            buffer = io.BytesIO()
            np.save(buffer, values)
            parts[f"{cloud}|{array}.npy"] = buffer.getvalue()
    with tarfile.open(FROZEN, "w:xz", preset=9) as packed:
        for part, data in parts.items():
            info = tarfile.TarInfo(part)
            info.size = len(data)
            packed.addfile(info, io.BytesIO(data))


if __name__ == "__main__":
    freeze()
