"""LAS files: metres, as the coordinate system says, in steps of 0.1 µm up to a width of 214 m.

LAS 1.4, point format 6; x, y and z are whole numbers of 1e-7 m from an offset, which reaches 214 m; of ten times that
where points are farther apart, and so on. Grey is the intensity, spread to 16 bit as the standard wants. Sigma, normals
and further columns are extra bytes, whose descriptions name their unit. Metadata are the standard's text area, line by
line. The coordinate system is a local one in OGC WKT, since the place of a dive on Earth is unknown.
Source: ASPRS, "LAS Specification 1.4 - R15" (2019). Written by laspy (BSD).
"""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from appliance.base import needed
from appliance.desk.export.content import MM_PER_M, ExportedPoints, Metadata, finite, scaled_to_mm
from appliance.store import LocalFileSystem

SCALE_M = 1e-7
_MM = "_mm"
_LOCAL = (
    'LOCAL_CS["{title}",LOCAL_DATUM["{frame}",0],UNIT["{unit}",1.0],AXIS["X",OTHER],AXIS["Y",OTHER],AXIS["Z",OTHER]]'
)
_TO_16_BIT = 257
"""255 becomes 65535."""
_TEXT_AREA = ("LASF_Spec", 3)
"""User and number of the record with the text: ASCII that ends with a zero, at most 65535 bytes (section 3.3)."""
_MAX_TEXT_BYTES = 65_534
_DATE = slice(90, 94)
"""Bytes of the head with the day and year of creation (table 3)."""


def write_points(path: Path, points: ExportedPoints, metadata: Metadata) -> None:
    """Write the file. Raises StorageError, MissingLibraryError where laspy is absent."""
    LocalFileSystem().replace_file(path, encode_las(scaled_to_mm(points, metadata), metadata))


def encode_las(points: ExportedPoints, metadata: Metadata) -> bytes:
    """Return the file. Raises MissingLibraryError where laspy is absent."""
    laspy = needed("laspy", "laspy", "a LAS file")
    header = laspy.LasHeader(version="1.4", point_format=6)
    metres = (points.points_mm.astype(np.float64) + points.origin_mm) / MM_PER_M
    header.offsets = np.floor(metres.min(axis=0, initial=np.inf)) if len(metres) else np.zeros(3)
    widest_m = float((metres - header.offsets).max(initial=0.0))
    steps = max(0, int(np.ceil(np.log10(max(widest_m, SCALE_M) / (SCALE_M * np.iinfo(np.int32).max)))))
    header.scales = np.full(3, SCALE_M * 10.0**steps)
    unit = metadata.unit or "metre"
    header.system_identifier = f"Kingfisher, unit {unit}"
    header.generating_software = "kingfisher"
    title, frame = (text.replace('"', "'") for text in (metadata.lines("m")[0], metadata.frame))
    header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(_LOCAL.format(title=title, frame=frame, unit=unit)))
    header.global_encoding.wkt = True
    text = "\n".join(metadata.lines("m")).encode("ascii")[:_MAX_TEXT_BYTES] + b"\0"
    header.vlrs.append(laspy.vlrs.VLR(*_TEXT_AREA, "remarks on all points", text))
    normals = finite(points.normals)
    extra = {
        f"sigma_{metadata.unit or 'm'}": (points.sigma_mm.astype(np.float64) / MM_PER_M, f"standard deviation, {unit}"),
        "normal_x": (normals[:, 0], "unit vector"),
        "normal_y": (normals[:, 1], "unit vector"),
        "normal_z": (normals[:, 2], "unit vector"),
        **dict(_column(name, values) for name, values in points.more.items()),
    }
    header.add_extra_dims([laspy.ExtraBytesParams(name, "float32", text) for name, (_, text) in extra.items()])
    file = laspy.LasData(header)
    file.x, file.y, file.z = metres.T
    file.intensity = points.grey.astype(np.uint16) * _TO_16_BIT
    # Numbers of returns begin with 1; a point of format 6 that says 0 of 0 is invalid.
    file.return_number = np.ones(len(metres), np.uint8)
    file.number_of_returns = np.ones(len(metres), np.uint8)
    for name, (values, _) in extra.items():
        file[name] = values.astype(np.float32)
    buffer = io.BytesIO()
    file.write(buffer)
    # The library writes today's date, which would give another file each day; day 0 of year 0 means no date.
    buffer.getbuffer()[_DATE] = bytes(4)
    return buffer.getvalue()


def _column(name: str, values: NDArray[np.float32]) -> tuple[str, tuple[NDArray[np.float64], str]]:
    """Return a further column, in metres if it is in mm, since the file has one unit."""
    if name.endswith(_MM):
        return f"{name.removesuffix(_MM)}_m", (values.astype(np.float64) / MM_PER_M, "metre")
    return name, (values.astype(np.float64), "see name for the unit")
