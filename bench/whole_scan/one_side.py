"""One side of a comparison of two revisions: the parts of a scan, timed by the program of the present tree.

    python -P one_side.py SCENE WIDTH_PX FOLDER        with the tree in PYTHONPATH

It is run by its path, in this tree's form for both sides. It prints a line when all is loaded, with digests of the
results of the scene, then times one scan for each line that it reads.
"""

from __future__ import annotations

import hashlib
import json
import sys
from pathlib import Path

from appliance.measure.points.pipeline import Pipeline
from appliance.measure.procedure import SequenceProcessor
from bench.whole_scan.parts import procedure
from bench.whole_scan.scenes import TimedScene, timed_scene


def main() -> None:
    """Run a round for each line of stdin, and print its times as JSON."""
    scene = timed_scene(sys.argv[1], int(sys.argv[2]), Path(sys.argv[3]))
    scene_digests = digests(scene)
    with procedure(scene) as timed:
        _say(scene_digests)
        for _ in sys.stdin:
            timed.round()
            _say({part: taken_ms[-1] for part, taken_ms in timed.parts_ms().items()})
            timed.forget()


def digests(scene: TimedScene) -> dict[str, str]:
    """Return a digest of all points, as ``points``, and of each judgement by its name."""
    with Pipeline(scene.calibration, scene.water, scene.sequence, noise=scene.settings.noise) as pipeline:
        processor = SequenceProcessor(pipeline, scene.calibration, scene.water)
        full = processor.process(scene.frames, scene.settings)
        cloud = pipeline.table.cloud(full.cloud)
    points = hashlib.sha256()
    for column in (
        cloud.points_mm,
        cloud.intensity,
        cloud.modulation_dn,
        cloud.ray_gap_mm,
        cloud.sigma_mm,
        cloud.pixel,
    ):
        points.update(column.tobytes())
    texts = {judgement.verdict.name: repr((judgement.verdict, judgement.fault)) for judgement in full.judgements}
    return {"points": points.hexdigest()} | {
        name: hashlib.sha256(text.encode()).hexdigest() for name, text in texts.items()
    }


def _say(answer: object) -> None:
    sys.stdout.write(json.dumps(answer) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
