"""Owns the names that scripts and notebooks use: ``import kingfisher``. Each is loaded when it is first asked for.

They are the program's own classes and functions under one roof; docs/python.md shows what to do with them. Before the first of
them is loaded, compiled kernels are looked for, as the command line does: numba asks for their folder when a kernel is defined.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # for editors and type checkers; at run time ``__getattr__`` finds each by the table below
    from appliance.calibration.file import Calibration as Calibration
    from appliance.calibration.file import CalibrationError as CalibrationError
    from appliance.calibration.file import load as load_calibration  # noqa: F401
    from appliance.export.content import ExportError as ExportError
    from appliance.offline.comparing import Comparison as Comparison
    from appliance.offline.comparing import NominalSurface as NominalSurface
    from appliance.offline.comparing import compare as compare
    from appliance.offline.object_scripting import ObjectOfDive as ObjectOfDive
    from appliance.offline.object_scripting import open_object as open_object
    from appliance.offline.objects import ready_scan as ready_scan
    from appliance.offline.organised_scan import OrganisedScan as OrganisedScan
    from appliance.offline.scripting import Dive as Dive
    from appliance.offline.scripting import ScanOfDive as ScanOfDive
    from appliance.offline.scripting import export as export
    from appliance.offline.scripting import open_dive as open_dive
    from appliance.offline.scripting import open_scan as open_scan
    from appliance.optics.water import Water as Water
    from appliance.reconstruct.organised import OrganisedCloud as OrganisedCloud
    from appliance.registration.joint import JointErrors as JointErrors
    from appliance.registration.joint import LengthSigma as LengthSigma
    from appliance.registration.pair import ReadyScan as ReadyScan
    from appliance.registration.pair import RegisteredPair as RegisteredPair
    from appliance.registration.pair import register as register
    from appliance.registration.reference import SurfaceMatchError as SurfaceMatchError
    from appliance.registration.rigid import Rigid as Rigid
    from appliance.registration.solve import Solved as Solved
    from appliance.registration.solve import solve as solve
    from appliance.report.content import Report as Report
    from appliance.report.content import ReportBudget as ReportBudget
    from appliance.report.content import ReportNominal as ReportNominal
    from appliance.report.content import ReportPair as ReportPair
    from appliance.report.content import ReportScan as ReportScan
    from appliance.report.content import ReportTerm as ReportTerm
    from appliance.report.content import ReportVerdict as ReportVerdict
    from appliance.report.page import write_report as write_report
    from appliance.storage.objects import ObjectError as ObjectError
    from appliance.storage.objects import StoredObject as StoredObject
    from appliance.storage.scan import ScanError as ScanError
    from appliance.surface.deviation import Deviation as Deviation
    from appliance.surface.deviation import deviations as deviations
    from appliance.surface.fusion import FusedCloud as FusedCloud
    from appliance.surface.fusion import PlacedScan as PlacedScan
    from appliance.surface.fusion import fuse as fuse
    from appliance.surface.mesh import Mesh as Mesh
    from appliance.surface.mesh import mesh_of_scan as mesh_of_scan
    from appliance.surface.nominal import Nominal as Nominal
    from appliance.surface.nominal import nominal_of_mesh as nominal_of_mesh
    from appliance.surface.nominal import read_nominal as read_nominal
    from appliance.surface.normals import normals as normals
    from appliance.surface.object_mesh import mesh_of_surface as mesh_of_surface

_HOMES = {
    "appliance.calibration.file": ("Calibration", "CalibrationError", "load as load_calibration"),
    "appliance.export.content": ("ExportError",),
    "appliance.offline.comparing": ("Comparison", "NominalSurface", "compare"),
    "appliance.offline.object_scripting": ("ObjectOfDive", "open_object"),
    "appliance.offline.objects": ("ready_scan",),
    "appliance.offline.organised_scan": ("OrganisedScan",),
    "appliance.offline.scripting": ("Dive", "ScanOfDive", "export", "open_dive", "open_scan"),
    "appliance.optics.water": ("Water",),
    "appliance.reconstruct.organised": ("OrganisedCloud",),
    "appliance.registration.joint": ("JointErrors", "LengthSigma"),
    "appliance.registration.pair": ("ReadyScan", "RegisteredPair", "register"),
    "appliance.registration.reference": ("SurfaceMatchError",),
    "appliance.registration.rigid": ("Rigid",),
    "appliance.registration.solve": ("Solved", "solve"),
    "appliance.report.content": (
        "Report", "ReportBudget", "ReportNominal", "ReportPair", "ReportScan", "ReportTerm", "ReportVerdict",
    ),
    "appliance.report.page": ("write_report",),
    "appliance.storage.objects": ("ObjectError", "StoredObject"),
    "appliance.storage.scan": ("ScanError",),
    "appliance.surface.deviation": ("Deviation", "deviations"),
    "appliance.surface.fusion": ("FusedCloud", "PlacedScan", "fuse"),
    "appliance.surface.mesh": ("Mesh", "mesh_of_scan"),
    "appliance.surface.nominal": ("Nominal", "nominal_of_mesh", "read_nominal"),
    "appliance.surface.normals": ("normals",),
    "appliance.surface.object_mesh": ("mesh_of_surface",),
}  # fmt: skip
"""Modules with what is taken from each, under its own name or another."""
_FOUND = {
    wanted.rpartition(" as ")[2]: (module, wanted.partition(" as ")[0])
    for module, names in _HOMES.items()
    for wanted in names
}

__version__ = importlib.import_module("appliance").__version__


def __getattr__(name: str) -> Any:
    """Return one of the names above. Raises AttributeError for any other."""
    if name not in _FOUND:
        raise AttributeError(f"module 'kingfisher' has no attribute {name!r}; there are: {', '.join(sorted(_FOUND))}")
    from appliance import kernel_cache

    kernel_cache.use()
    module, attribute = _FOUND[name]
    return getattr(importlib.import_module(module), attribute)


def __dir__() -> list[str]:
    return sorted((*_FOUND, "__version__"))
