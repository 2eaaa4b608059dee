"""Everything that the program makes of the recordings: clouds, verdicts, and what each verb answers.

A call's answer is its exit code, its JSON document and its errors. Taken out is only what another run or processor makes otherwise:
times, the folder it was made in, progress, and checksums over these or over clouds, which are compared by themselves.
"""

from __future__ import annotations

import io
import json
import re
import shlex
from collections.abc import Callable, Iterable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.base import silent
from appliance.calibrate.recordings import ArtefactKind, Recording
from appliance.calibrate.stored_recordings import recording_of_scan
from appliance.calibrate.water.calibrate import calibrate
from appliance.calibrate.water.method import Method
from appliance.calibrate.water.report import as_html
from appliance.cli import main
from appliance.desk.reconstruct import work_through
from appliance.instrument.worker.neighbours import Neighbours
from appliance.measure import NotFound
from appliance.measure.calibration.file import Calibration, encode_calibration
from appliance.measure.light.acquisition import AcquisitionSettings
from appliance.measure.light.sides import SIDES
from appliance.measure.motion.estimate import estimate
from appliance.measure.motion.redecode import compensate
from appliance.measure.news import CoarseCloud, FullCloud, PatternIdentity, Verdicts
from appliance.measure.points.pipeline import Pipeline
from appliance.measure.procedure import SequenceProcessor
from appliance.measure.scan_images import ScanImages
from appliance.store.config import load_rig
from appliance.store.instrument import Instrument, load_calibration
from appliance.store.origin import SourceScan
from appliance.store.scan import ScanError, StoredScan
from appliance.store.wish import ScanOptions
from tests.support.truth import WATER

ROOTS = {"root": "rig.toml", "second": "second.toml"}
"""Storage roots of the recordings, each with its rig file."""
CALLS = (
    ("scans-list", "scans list --root root --all"),
    ("scans-show", "scans show --root root 1"),
    ("scans-verify", "scans verify --root root"),
    ("scans-label-name", 'scans label --root root 1 --name "The first"'),
    ("scans-label-note", 'scans label --root root 1 --note "clear water"'),
    ("scans-trash", "scans trash --root root 2"),
    ("scans-list-trash", "scans list trash --root root"),
    ("scans-restore", "scans restore --root root 2"),
    ("cloud", "cloud --rig rig.toml root/scans/000001 --out still.ply"),
    ("cloud-wrong", "cloud --rig rig.toml root/rejected/000011 --out wrong.ply"),
    ("cloud-grid", "cloud --root root 1 --out still.npz"),
    ("cloud-many", "cloud --root root 1 3 --out exported-{}.las"),
    ("cloud-e57", "cloud --root root 1 --out still.e57"),
    ("cloud-incomplete", "cloud --root root incomplete:1 --out rescued.ply"),
    ("cloud-merged", "cloud --rig rig.toml root/scans/000001+root/scans/000012 --out merged.ply"),
    ("cloud-merged-far-apart", "cloud --rig rig.toml root/scans/000001+root/scans/000002 --out apart.ply"),
    ("object-add-new", "object add --root root Frustum 1 2"),
    ("object-add", "object add --root root Frustum 3"),
    ("object-solve", "object solve --root root Frustum"),
    ("object-show", "object show --root root Frustum"),
    ("cloud-object", "cloud --root root object:Frustum --out solved.ply --mesh --out frustum.stl"),
    ("cloud-mesh", "cloud --root root 1 --out still.stl"),
    ("compare", "compare --root root 1 still.stl --start 0,0,0,0,0,0 --out compared.ply"),
    ("evaluate", "evaluate list.toml --rig rig.toml --out evaluation.html"),
    ("report", "report --root root --out report.html"),
    ("archive-pack", "archive pack root --out packed"),
    ("scans-verify-packed", "scans verify --root packed --all"),
    ("archive-unpack", "archive unpack packed 1 --out unpacked"),
    ("scans-show-frame", "scans show packed/scans/000001 left sine-x-90 --out frame.png"),
    ("archive-reprocess", "archive reprocess packed --workers 1 --out again"),
    ("calibration-show", "calibration show --root root"),
    ("calibration-nominal", "calibration show nominal --rig rig.toml --out nominal.json"),
    ("calibration-measure-noise", "calibration measure noise --root root 6"),
    ("calibration-measure-response", "calibration measure response --root root 13 --install"),
    ("calibration-measure-exposures", "calibration measure exposures --root root 13"),
    ("calibration-air-pair", "calibration air boards --pair boards --board 15 --out pair.json"),
    ("import-folder", "import foreign/three-steps --out three.ply"),
    ("import-description", "import foreign/two-directions/two-directions.toml --out two.ply"),
    ("missing-scan", "cloud --root root 99"),
    ("not-a-verb", "reconstrict root"),
)
"""Name and words of each call, in the order of their effects."""
Change = Callable[[StoredScan], StoredScan]


def _seen(change: Callable[[NDArray[Any]], NDArray[Any]], *sides: str) -> Change:
    """Change each image that a camera took, those of ``sides`` alone where some are named."""

    def changed(scan: StoredScan) -> StoredScan:
        frames = {
            side: np.rint(change(own)).clip(0, 255).astype(np.uint8) if side in (sides or scan.frames) else own
            for side, own in scan.frames.items()
        }
        return replace(scan, frames=frames)

    return changed


def _flickers(share: float, hz: float) -> Callable[[NDArray[Any]], NDArray[Any]]:
    def changed(frames: NDArray[Any]) -> NDArray[Any]:
        light = 1.0 + share * np.sin(2.0 * np.pi * hz / 60.0 * np.arange(len(frames)))
        scaled: NDArray[Any] = frames * light[:, None, None]
        return scaled

    return changed


def _stays(first: int) -> Callable[[NDArray[Any]], NDArray[Any]]:
    """Show the image ``first`` to the end."""
    return lambda frames: frames[np.minimum(np.arange(len(frames)), first)]


def _at_the_shortest(scan: StoredScan) -> StoredScan:
    bright = _seen(lambda frames: frames * 3.0)(scan)
    record = replace(scan.manifest.record, exposure=Instrument(load_rig(Path("rig.toml"))).exposures[0])
    return replace(bright, manifest=replace(scan.manifest, record=record))


CHANGES: dict[str, tuple[str, Change]] = {
    "light that flickers at 20 Hz": ("000001", _seen(_flickers(0.06, 20.0))),
    "light that flickers a little at 11 Hz, wide stripes": ("000013", _seen(_flickers(0.01, 11.0))),
    "a third of the light": ("000001", _seen(lambda frames: frames / 3.0)),
    "twice the light": ("000001", _seen(lambda frames: frames * 2.0)),
    "three times the light at the shortest exposure": ("000001", _at_the_shortest),
    "a projector that stands still": ("000001", _seen(_stays(5))),
    "a left camera whose image stays": ("000001", _seen(_stays(19), "left")),
}
"""What else may happen to a scan of the instrument: its number, and the change."""
VARYING = re.compile(
    r"(_s|^s|seconds|peak_mb|host|program|software_version|made_at|made_by|^hash|^sha256|^key|^table|^stored_cloud|^cloud_sha256)$"
)
"""Keys of what differs from run to run or from processor to processor: durations, the program's version, and checksums over times, programs or clouds."""
FIELDS = {"float": "<f4", "double": "<f8", "uchar": "u1", "int": "<i4", "uint": "<u4"}
BAR_MM, BALL_MM = 150.0, 15.0
SPEED_MM_S = 30.0
FLOOR = 1e-6
"""Numbers below it are compared as if they were as large."""
ERRORS = "depth_error_mm2"
"""Errors of a calibration are differences of its solutions, and have a digit less."""
NOW = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d(\.\d+)?)?(Z|[+-]\d\d:\d\d)?")


@dataclass
class Outcome:
    """All answers by name, and all clouds by name."""

    said: dict[str, Any] = field(default_factory=dict)
    clouds: dict[str, dict[str, NDArray[Any]]] = field(default_factory=dict)


def outcome_of(folder: Path) -> Outcome:
    """Return everything that is made of the recordings unpacked in ``folder``, where the caller stands; files are added to it."""
    outcome, today = Outcome(), datetime.now(UTC).strftime("%Y-%m-%d")
    for root, rig in ROOTS.items():
        for scan in sorted(path.parent for path in Path(root).glob("*/*/manifest.json")):
            name = f"{root}/{scan.name}"
            outcome.said[f"manifest {name}"] = json.loads((scan / "manifest.json").read_text(encoding="utf-8"))
            assert StoredScan.manifest_of(scan).scan_id == scan.name
            outcome.said[f"verdicts {name}"], outcome.clouds[name] = _processed(scan, rig)
    for name, (scan_id, change) in CHANGES.items():
        outcome.said[f"verdicts with {name}"], _ = _processed(Path("root/scans") / scan_id, ROOTS["root"], change)
    outcome.said["overlaps"] = list(_overlaps(["000001", "000002", "000003", "000004", "000013"]))
    outcome.said["recording of a plane"] = _recording("000013")
    outcome.said["followed along the fringes"] = _followed_along_the_fringes("000001")
    for name, words in CALLS:
        outcome.said[name] = _answer(shlex.split(words), today)
    for method in Method:
        outcome.said[f"calibrated in water: {method.value}"] = _calibrated_in_water(Path("water"), method, today)
    for path in sorted(folder.glob("*.ply")):
        outcome.clouds[path.name] = _cloud_file(path)
    for path in sorted(folder.glob("*.json")):
        outcome.said[f"file {path.name}"] = _steady(json.loads(path.read_text(encoding="utf-8")), today)
    return outcome


def _processed(scan: Path, rig: str, change: Change = lambda scan: scan) -> tuple[Any, dict[str, NDArray[Any]]]:
    """Return verdicts and cloud of a scan after a ``change``."""
    wish = ScanOptions(rig=load_rig(Path(rig)), root=scan.parents[1])
    source = SourceScan.open(scan, wish)
    try:
        changed, calibration = change(source.scan), source.calibration_for(wish).calibration
        facts = list(_facts(changed, calibration, Instrument(source.rig).settings_of_scan(changed.manifest.record)))
        worked = work_through(changed, source.rig, calibration, silent)
    except ScanError as error:
        return {"refused": str(error), "facts": facts}, {}
    verdicts = [
        {
            "name": one.verdict.name,
            "passed": one.verdict.passed,
            "numbers": dict(one.verdict.numbers),
            "text": one.verdict.text,
            "fault": None if one.fault is None else one.fault.code.value,
            "proposal": str(one.proposal),
            "second": str(one.second),
        }
        for one in worked.judgements
    ]
    cloud = worked.cloud
    arrays = {"pixel": cloud.pixel, "points_mm": cloud.points_mm, "sigma_mm": cloud.sigma_mm}
    return {"grade": worked.grade.value, "verdicts": verdicts, "facts": facts}, arrays


def _facts(scan: StoredScan, calibration: Calibration, settings: AcquisitionSettings) -> Iterator[Any]:
    """Yield what the instrument hears of a sequence, fact by fact."""
    water = scan.water(calibration)
    with Pipeline(calibration, water, scan.sequence, noise=settings.noise) as pipeline:
        processor = SequenceProcessor(pipeline, calibration, water)
        # A sequence that was cut off leaves nothing behind.
        processor.begin(settings)
        for index in range(len(scan.sequence) // 2):
            for side, frames in scan.frames.items():
                processor.push(side, frames[::-1], index)
        processor.begin(settings)
        for _ in processor.push_all(scan.frames):
            pass
        for fact in processor.steps():
            match fact:
                case PatternIdentity(judgement):
                    yield ["PatternIdentity", judgement.verdict.passed]
                case Verdicts(judgements):
                    yield ["Verdicts", [one.verdict.name for one in judgements], fact.compensating]
                case CoarseCloud(found) | FullCloud(found):
                    yield [type(fact).__name__, found.summary.points]


def _overlaps(scan_ids: Iterable[str]) -> Iterator[Any]:
    """Yield the share of each scan that the one before has, as the diver is told."""
    neighbours: Neighbours | None = None
    for scan_id in scan_ids:
        wish = ScanOptions(rig=load_rig(Path(ROOTS["root"])), root=Path("root"))
        source = SourceScan.open(Path("root/scans") / scan_id, wish)
        scan, calibration = source.scan, source.calibration_for(wish).calibration
        water = scan.water(calibration)
        with Pipeline(calibration, water, scan.sequence) as pipeline:
            for index in range(len(scan.sequence)):
                for side, frames in scan.frames.items():
                    pipeline.push(side, frames, index)
            coarse = pipeline.table.cloud(pipeline.find_coarse())
            stride_px = pipeline.coarse_stride
        neighbours = neighbours or Neighbours(calibration, water, scan.sequence, stride_px)
        neighbours.begin(1)
        neighbours.coarse(coarse)
        neighbours.add_full(scan.frames["left"])
        while neighbours.has_work:
            if (fact := neighbours.go_on()) is not None:
                yield [scan_id, fact.overlap.share, fact.overlap.none, fact.overlap.scant]
        neighbours.keep()


def _recording(scan_id: str) -> Any:
    """Return what a calibration in water takes of a scan of a plane: number and mean places of its points."""
    scan, wish = Path("root/scans") / scan_id, ScanOptions(rig=load_rig(Path(ROOTS["root"])), root=Path("root"))
    source = SourceScan.open(scan, wish)
    recording = recording_of_scan(scan, None, source.calibration_for(wish).calibration, source.rig, silent)
    if isinstance(recording, NotFound):
        return recording.reason
    return [len(recording.left_px), recording.left_px.mean(0).tolist(), recording.right_px.mean(0).tolist()]


def _followed_along_the_fringes(scan_id: str) -> Any:
    """Return what is decoded of a scan whose points are followed as if the hand moved along with the fringes."""
    wish = ScanOptions(rig=load_rig(Path(ROOTS["root"])), root=Path("root"))
    source = SourceScan.open(Path("root/scans") / scan_id, wish)
    scan, calibration = source.scan, source.calibration_for(wish).calibration
    water, settings = scan.water(calibration), Instrument(source.rig).settings_of_scan(scan.manifest.record)
    with Pipeline(calibration, water, scan.sequence, noise=settings.noise) as pipeline:
        for index in range(len(scan.sequence)):
            for side, frames in scan.frames.items():
                pipeline.push(side, frames, index)
        pipeline.find_coarse()
        sample = pipeline.sample(pipeline.coarse_stride)
        images = ScanImages(scan.sequence, scan.frames, {side: pipeline.decoded(side) for side in SIDES}, settings)
        motion = estimate(images, calibration, water, sample.points_mm, sample.pixel)
        moved_mm = motion.trajectory_mm.copy()
        moved_mm[:, 0] += SPEED_MM_S * (settings.frame_s * np.arange(len(moved_mm)) - motion.reference_s)
        maps = compensate(images, calibration, water, replace(motion, trajectory_mm=moved_mm))
    finite = {side: np.isfinite(maps[side].p_px) for side in SIDES}
    return {
        side: [
            int(np.count_nonzero(finite[side])),
            float(maps[side].p_px[finite[side]].mean(dtype=np.float64)),
            float(np.median(maps[side].variance_px2[finite[side]])),
        ]
        for side in SIDES
    }


def _calibrated_in_water(folder: Path, method: Method, today: str) -> Any:
    stored: dict[str, dict[str, Any]] = {}
    with np.load(folder / "recordings.npz") as arrays:
        for key in arrays:
            name, _, array = key.partition("|")
            stored.setdefault(name, {})[array] = arrays[key]
    recordings = [
        Recording(name, ArtefactKind.BALL_BAR, water=WATER, length_mm=BAR_MM, radius_mm=BALL_MM, **one)
        if name.startswith("bar")
        else Recording(name, ArtefactKind.PLANE, water=WATER, **one)
        for name, one in stored.items()
    ]
    result = calibrate(method, recordings, load_calibration(folder / "air.json"))
    said = json.loads(encode_calibration(result.calibration))
    page = as_html(result, load_calibration(folder / "air.json"), {}, {"000009": "too few points"})
    problems = re.findall(r'<p class="no">(.*?)</p>', page)
    return _steady(
        {
            "calibration": said,
            "systematic_px": result.systematic_px,
            "warnings": list(result.warnings),
            "problems": problems,
        },
        today,
    )


def _answer(words: list[str], today: str) -> dict[str, Any]:
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        try:
            code = int(main([*words, "--json"]))
        except SystemExit as left:
            code = int(left.code or 0)
    text = out.getvalue()
    said = json.loads(text) if text else None
    # Progress comes where a computer is slow.
    errors = [line for line in err.getvalue().splitlines() if not line.startswith('{"info"')]
    return {"exit": code, "said": _steady(said, today), "error": _steady(errors, today) if code else None}


def _cloud_file(path: Path) -> dict[str, NDArray[Any]]:
    """Return the vertices of a PLY file by its own header, whoever wrote it."""
    header, body = path.read_bytes().split(b"end_header\n", 1)
    count, fields = 0, []
    for words in (line.split() for line in header.decode().splitlines()):
        if words[0] == "element":
            count = int(words[2]) if words[1] == "vertex" else count
            mesh = words[1] != "vertex"
        elif words[0] == "property" and not mesh:
            fields.append((words[2], FIELDS[words[1]]))
    table = np.frombuffer(body, np.dtype(fields), count)
    return {name: table[name].copy() for name, _ in fields}


def _steady(value: Any, today: str) -> Any:
    """Return a document without times of today, durations and the folder that it was made in."""
    if isinstance(value, dict):
        return {key: _steady(one, today) for key, one in value.items() if not VARYING.search(key)}
    if isinstance(value, list):
        return [_steady(one, today) for one in value]
    if not isinstance(value, str):
        return value
    return NOW.sub(lambda found: "<now>" if found[0] >= today else found[0], value.replace(str(Path.cwd()), "HERE"))


def differences(wanted: Any, found: Any, share: float, at: str = "", beside: float = FLOOR) -> Iterator[str]:
    """Yield where two documents differ: in anything but numbers by less than a ``share`` of the largest one beside them."""
    if isinstance(wanted, dict) and isinstance(found, dict):
        for key in [*wanted, *(key for key in found if key not in wanted)]:
            if key in wanted and key in found:
                yield from differences(wanted[key], found[key], share, f"{at}/{key}")
            else:
                yield f"{at}/{key}: {'missing' if key in wanted else 'new'}"
    elif isinstance(wanted, list) and isinstance(found, list) and len(wanted) == len(found):
        largest = max(beside, _largest(wanted))
        for k, (one, other) in enumerate(zip(wanted, found, strict=True)):
            yield from differences(one, other, share, f"{at}[{k}]", largest)
    elif not _same(wanted, found, share * (10.0 if ERRORS in at else 1.0) * max(beside, _largest(wanted))):
        yield f"{at}: {wanted!r} became {found!r}"


def _largest(value: Any) -> float:
    """Return the largest number of a list of numbers, or of lists of them."""
    if isinstance(value, list):
        return max(map(_largest, value), default=0.0)
    return abs(value) if isinstance(value, float) else 0.0


def _same(wanted: Any, found: Any, most: float) -> bool:
    if isinstance(wanted, float) and isinstance(found, float | int):
        return abs(found - wanted) <= most
    return bool(wanted == found)
