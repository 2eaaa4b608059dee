"""Entry to the import of foreign images.

Description, file headers and camera numbers are checked before modules that compute are loaded; then come decoding and
points.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from appliance.base import Progress
from appliance.desk.foreign.description import Description, load_description, with_counts
from appliance.desk.foreign.problem import ForeignError

if TYPE_CHECKING:  # brings NumPy
    from appliance.desk.foreign.cameras import ForeignRig
    from appliance.desk.foreign.images import ImageSet

MOST_PX = 65_535
"""Largest width and height of an image with two directions: pixel indices are packed into 16 bits each."""


def check_import(path: Path, out: Path) -> None:
    """Check all that can be checked without decoding: words, image files, camera numbers, and ``out``.

    ``out`` without a suffix is a scan folder. No kernel is needed. Raises ForeignError, ExportError, MissingLibraryError.
    """
    # Wrong words and missing images are the usual faults of a first try.
    described = load_description(path)
    from appliance.desk.foreign.images import first_of_side

    description, images, _ = check_images(
        path, described, {side: first_of_side(described, side) for side in described.files}
    )
    if out.suffix:
        from appliance.desk.export.formats import SCAN_SUFFIXES, check_suffix, require_library

        check_suffix(out, SCAN_SUFFIXES, "a cloud")
        require_library(out)
    longest_px = max(max(image_set.shape) for image_set in images.values())
    if "right" not in images:
        longest_px = max(longest_px, *description.projector_px)
    if longest_px > MOST_PX and not description.one_direction:
        raise ForeignError(
            f"{path}: an image or the projector has a side of {longest_px} px; allowed for two directions are up to "
            f"{MOST_PX} px; crop it, or describe one direction only"
        )
    if not out.suffix:
        if out.exists():
            raise ForeignError(f"--out {out}: exists already; give the name of a new folder")
        if not out.absolute().parent.is_dir():
            raise ForeignError(f"--out {out}: there is no folder {out.parent}; make it first, or give another one")
        from appliance.desk.foreign.own_form import require_sequence

        require_sequence(path, out, description, images["left"])


def import_images(
    source: Path, out: Path, progress: Progress, *, as_described: bool = False, reasons: Path | None = None
) -> dict[str, Any]:
    """Import the images below the folder ``source``, or those that the description ``source`` describes.

    Returns the report. Raises as ``import_folder`` and ``import_described``.
    """
    if source.is_dir():
        from appliance.desk.foreign.folder import import_folder

        return import_folder(source, out, progress, reasons)
    from appliance.desk.foreign.importing import import_described

    return import_described(source, out, progress, as_described=as_described, reasons=reasons)


def check_images(
    path: Path, described: Description, sets: Mapping[str, ImageSet]
) -> tuple[Description, Mapping[str, ImageSet], ForeignRig]:
    """Return the description with its images counted, the images, and the cameras that took them.

    Raises ForeignError if they do not belong together.
    """
    from appliance.desk.foreign.cameras import read_rig

    description = with_counts(described, sets["left"].shown)
    if "right" in sets and set(sets["right"].shown) != set(sets["left"].shown):
        raise ForeignError(f"{path}: left and right have different kinds of images; name the same kinds for both")
    sizes_px = {side: (image_set.shape[1], image_set.shape[0]) for side, image_set in sets.items()}
    sizes_px.setdefault("right", description.projector_px)
    return description, sets, read_rig(description, sizes_px)
