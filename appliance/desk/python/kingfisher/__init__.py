"""Python interface to stored dives: points in mm as NumPy arrays, objects, meshes and deviations.

    dive = kingfisher.open_dive("ROOT")           the folder that holds scans/
    scan = dive[7]                                <scan 000007: 282,679 points, 21 µm, good>
    made = scan.points()                          made.points_mm (n, 3), made.sigma_mm (n,)
    kingfisher.export(made, "scan.e57")

The names, each with a help of its own, in ``kingfisher.__all__``:

    scans          open_dive open_scan Dive ScanOfDive Grade OrganisedScan OrganisedCloud Water
    calibrations   load_calibration save_calibration Calibration
    registration   ready_scan register solve ReadyScan RegisteredPair Rigid Solved
    objects        open_object ObjectOfDive StoredObject JointErrors LengthSigma
    surfaces       PlacedScan fuse FusedCloud normals mesh_of_scan mesh_of_surface Mesh
    deviations     read_nominal nominal_of_mesh compare deviations Nominal NominalSurface Comparison Deviation
    files          export Report ReportBudget ReportNominal ReportPair ReportScan ReportTerm ReportVerdict write_report
    errors         CalibrationError ConfigError ExportError MissingLibraryError NominalError ObjectError ScanError StorageError
                   SurfaceMatchError UnknownScan; a wrong type is a TypeError, a folder that is not there a NotADirectoryError

Each is loaded on first use. They are the program's own classes and functions in one module; functions compare their
arguments with their annotations first. Before the first of them is loaded, compiled kernels are searched, as the command
line does: numba needs their folder when a kernel is defined.
"""

from __future__ import annotations

import functools
import importlib
import inspect
from typing import TYPE_CHECKING, Any

from appliance.base import modules_of_face

if TYPE_CHECKING:  # for editors and type checkers; at run time ``__getattr__`` reads the same list
    from appliance.base import MissingLibraryError as MissingLibraryError
    from appliance.desk.comparing import Comparison as Comparison
    from appliance.desk.comparing import NominalSurface as NominalSurface
    from appliance.desk.comparing import compare as compare
    from appliance.desk.export.formats import ExportError as ExportError
    from appliance.desk.object_scripting import ObjectOfDive as ObjectOfDive
    from appliance.desk.object_scripting import open_object as open_object
    from appliance.desk.object_store import ObjectError as ObjectError
    from appliance.desk.object_store import StoredObject as StoredObject
    from appliance.desk.objects import ready_scan as ready_scan
    from appliance.desk.organised import OrganisedScan as OrganisedScan
    from appliance.desk.registration.joint import JointErrors as JointErrors
    from appliance.desk.registration.joint import LengthSigma as LengthSigma
    from appliance.desk.registration.reference import SurfaceMatchError as SurfaceMatchError
    from appliance.desk.registration.solve import Solved as Solved
    from appliance.desk.registration.solve import solve as solve
    from appliance.desk.report.content import Report as Report
    from appliance.desk.report.content import ReportBudget as ReportBudget
    from appliance.desk.report.content import ReportNominal as ReportNominal
    from appliance.desk.report.content import ReportPair as ReportPair
    from appliance.desk.report.content import ReportScan as ReportScan
    from appliance.desk.report.content import ReportTerm as ReportTerm
    from appliance.desk.report.content import ReportVerdict as ReportVerdict
    from appliance.desk.report.page import write_report as write_report
    from appliance.desk.scripting import Dive as Dive
    from appliance.desk.scripting import ScanOfDive as ScanOfDive
    from appliance.desk.scripting import export as export
    from appliance.desk.scripting import open_dive as open_dive
    from appliance.desk.scripting import open_scan as open_scan
    from appliance.desk.scripting import save_calibration as save_calibration
    from appliance.desk.surface.deviation import Deviation as Deviation
    from appliance.desk.surface.deviation import deviations as deviations
    from appliance.desk.surface.fusion import FusedCloud as FusedCloud
    from appliance.desk.surface.fusion import PlacedScan as PlacedScan
    from appliance.desk.surface.fusion import fuse as fuse
    from appliance.desk.surface.mesh import Mesh as Mesh
    from appliance.desk.surface.mesh import mesh_of_scan as mesh_of_scan
    from appliance.desk.surface.nominal import Nominal as Nominal
    from appliance.desk.surface.nominal import NominalError as NominalError
    from appliance.desk.surface.nominal import nominal_of_mesh as nominal_of_mesh
    from appliance.desk.surface.nominal import read_nominal as read_nominal
    from appliance.desk.surface.normals import normals as normals
    from appliance.desk.surface.object_mesh import mesh_of_surface as mesh_of_surface
    from appliance.measure import Calibration as Calibration
    from appliance.measure import CalibrationError as CalibrationError
    from appliance.measure import Grade as Grade
    from appliance.measure import OrganisedCloud as OrganisedCloud
    from appliance.measure import ReadyScan as ReadyScan
    from appliance.measure import RegisteredPair as RegisteredPair
    from appliance.measure import Rigid as Rigid
    from appliance.measure import Water as Water
    from appliance.measure import register as register
    from appliance.store import ConfigError as ConfigError
    from appliance.store import ScanError as ScanError
    from appliance.store import StorageError as StorageError
    from appliance.store import UnknownScan as UnknownScan
    from appliance.store import load_calibration as load_calibration

_MODULES = modules_of_face(__name__)

__version__ = importlib.import_module("appliance").__version__
__all__ = [*sorted(_MODULES), "__version__"]


def __getattr__(name: str) -> Any:
    """Return one of the names above. Raises AttributeError for any other name."""
    if name not in _MODULES:
        from appliance.base import other_program

        message = f"module 'kingfisher' has no attribute {name!r}; there are: {', '.join(sorted(_MODULES))}"
        raise AttributeError("; ".join(filter(None, (message, other_program()))))
    return _loaded(name)


@functools.cache
def _loaded(name: str) -> Any:
    from appliance.base import use_kernel_cache

    use_kernel_cache()
    value = getattr(importlib.import_module(_MODULES[name]), name)
    if not inspect.isfunction(value):
        return value
    from appliance.base import refuse_wrong_types

    checked = refuse_wrong_types(value, name)
    # Under its name in this module pickles find it again, too.
    checked.__module__, checked.__name__, checked.__qualname__ = __name__, name, name
    return checked


def __dir__() -> list[str]:
    return __all__
