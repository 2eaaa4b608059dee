"""What an instrument has on its disk, for tests that take it off: three scans, one that was broken off, a calibration, a rig file."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from appliance.store import label as labels
from appliance.store import scan as stored
from appliance.store.atomic import LocalFileSystem
from appliance.store.incomplete import IncompleteRecording
from appliance.store.manifest import Decision
from appliance.store.pull.pulling import Far, Open, PullResult, pull_from
from appliance.store.pull.source import FolderSource, LinkLost, RemoteEntry, Source
from tests.appliance.store.scenes import ORIGIN, PREVIEW, cloud, frames, record

FS = LocalFileSystem()


def scan(root: Path, number: str, first: int = 0, shelf: str = "scans") -> Path:
    """A whole scan with a cloud; ``first`` makes its pixels others."""
    folder = root / shelf / number
    folder.parent.mkdir(parents=True, exist_ok=True)
    raw = stored.write_raw(FS, folder, number, frames(first), record(), ORIGIN)
    stored.finish_scan(FS, folder, raw, Decision.KEPT, record(), cloud(), PREVIEW)
    return folder


def instrument(disk: Path) -> Path:
    """The storage root on an instrument's data partition ``disk``."""
    root = disk / "lib" / "kingfisher"
    for k, number in enumerate(("000001", "000002", "000003")):
        labels.Label(f"bollard {k}").write(FS, scan(root, number, k))
    scan(root, "000004", 4, "rejected")
    (root / "scans" / ".000005").mkdir()
    (root / "calibration" / "kept").mkdir(parents=True)
    (root / "calibration" / "current.json").write_text('{"of": "november"}\n')
    (root / "calibration" / "kept" / "0001-2026-11-01.json").write_text('{"of": "october"}\n')
    (disk / "etc" / "kingfisher").mkdir(parents=True)
    (disk / "etc" / "kingfisher" / "rig.toml").write_text('serial = "KF-0001"\n')
    broken = {side: one[:2] for side, one in frames().items()}
    IncompleteRecording.keep(FS, root, broken, record(), ORIGIN, "the board fell silent", 0)
    return root


def content(folder: Path) -> dict[str, bytes]:
    """Every file below a folder, by its path there, without what a call keeps for itself."""
    found = {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    return {path: data for path, data in found.items() if not path.startswith("run/")}


def opened(source: Source) -> Open:
    """A link that is always there."""

    @contextmanager
    def link() -> Iterator[Source]:
        yield source

    return link


def pulled(
    link: Source | Open, target: Path, fs: LocalFileSystem = FS, *, every: bool = False,
    far: Far = lambda *_: None,
) -> PullResult:  # fmt: skip
    """One call, which waits for nothing."""
    target.mkdir(exist_ok=True)
    return pull_from(link if callable(link) else opened(link), target, fs, every=every, far=far, wait=lambda _: None)


class BreakingSource:
    """A folder over a link that breaks for good after so many bytes, not counting what only says what there is."""

    def __init__(self, root: Path, lasts_bytes: int) -> None:
        self._there = FolderSource(root)
        self._left = lasts_bytes
        self.asked: list[tuple[str, int]] = []
        """Each file that was read, and from where on."""

    def listing(self, folder: str) -> list[RemoteEntry]:
        if self._left <= 0:
            raise LinkLost("the cable was pulled")
        return self._there.listing(folder)

    def read(self, path: str, start: int, end: int) -> Iterator[bytes]:
        self.asked.append((path, start))
        for data in self._there.read(path, start, end):
            counted = not path.endswith(".json")
            part = data[: max(0, self._left)] if counted or self._left <= 0 else data
            self._left -= len(data) if counted else 0
            yield part
            if len(part) < len(data):
                raise LinkLost("the cable was pulled")
