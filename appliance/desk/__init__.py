"""Work with stored scans away from the instrument: clouds, objects, comparison, reports, import, archives, Python."""

from __future__ import annotations

from typing import TYPE_CHECKING

from appliance.base import lazy_face

if TYPE_CHECKING:
    from .anew.results import (
        Results,  # Results of one key below out. Every method raises StorageError for what the disk refuses
        program_digits,  # Return what of an installation decides about points
        read_table,  # Return the rows of a table in the order of the scans' numbers, each a text by column
    )
    from .anew.season import (
        season_page,  # Return the page about the rows of a table (results.read_table); source is named on it
    )
    from .anew.work import (
        AGAIN,  # States of a row; one that is to be tried again is never published
        DONE,  # States of a row; one that is to be tried again is never published
        FAILED,  # States of a row; one that is to be tried again is never published
        Job,  # Everything that one scan's task must know; small, and the same bytes on every computer
        work_through_all,  # Yield a row of every job, as they are done by workers of scheduler
    )
    from .cloud_files import (
        ObjectFiles,  # The files of a solved object; its surface and the mesh of that are made once
        write_cloud,  # Write the cloud of a stored scan, of two of the same scene as one
    )
    from .comparing import (
        NominalSurface,  # A surface that others are compared with
        compare,  # Lay surface onto nominal by shape alone and return how far each point lies from it
        figures_of,  # Return a comparison in numbers, JSON-ready; lengths in mm
        write_comparison,  # Write a comparison: points with their deviation, or a page
    )
    from .dive_report import (
        report_of_dive,  # Return the page's content for scans under a storage root
    )
    from .evaluation import (
        run_evaluation,  # Reconstruct and measure every scan of the list
    )
    from .export.content import (
        CAMERA_FRAME,  # Words for the left camera frame
        About,  # Description of a file in it, as far as its format has room
    )
    from .export.formats import (
        ExportError,  # A file cannot be made; the text says which, why, and what to do
        check_file,  # Raises ExportError for a suffix that what (WRITTEN) is not written with
        has_triangles,  # Return whether a mesh is written to path; wanted: also where its suffix leaves the choice
    )
    from .foreign.first_look import (
        check_import,  # Refuse whatever can be refused at once
        import_images,  # Import the images below a folder, or those that a description describes
    )
    from .measuring import (
        exposure_found,  # Return how straight the fringes of a stored scan are. Raises ScanError
        noise_of_scan,  # Return by side the camera's noise in a stored scan, and what the rig file makes expect
        noise_to_store,  # Return what noise_of_scan found in a stored scan as figures of the instrument's cameras
        response_of_scan,  # Return the projector's response from the raw frames of a stored scan
    )
    from .object_errors import (
        errors_of,  # Return the joint errors of an object's places, scans in the order of places
        laid_onto_something,  # Return the surface with the sigma that is left once it lies on something by its shape
    )
    from .object_report import (
        report_of,  # Return the content of the page about a solved object
    )
    from .object_store import (
        ADDED_SINCE,  # Reason why a scan has no place yet
        MemberScan,  # A scan that belongs to the object
        Places,  # Places of an object's scans, and all that was found on the way
        StoredObject,  # An object: its scans, and where they lie if that was found out
        object_exists,  # Return whether there is an object of that name
        object_names,  # Return the names of all objects under a storage root, in order
        published_object,  # Return an object as stored now, with the places that were found for it
        read_object,  # Read an object. Raises ObjectError for one that is not there or is damaged
        update_object,  # Replace an object by change of what is stored now (None: there is none), under its lock
        with_scans,  # Return the object with scans added
    )
    from .objects import (
        about_object,  # Return what a file of the object says of it
        member_of,  # Return a stored scan as a member of an object. Raises ScanError
        overlap_news,  # Return what an object's overlaps tell of its calibration
        solve_object,  # Find where every scan of an object lies and return the object with its places
        surface_of,  # Return one surface of all scans that have a place, a point about every spacing_mm
    )
    from .organised import (
        organised_scan,  # Return the full cloud of a stored scan, of both exposures where it has two
    )
    from .reconstruct import (
        work_through,  # Reconstruct and judge a scan, one sequence or both. Raises ScanError
    )
    from .report.page import (
        write_report,  # Write the page, whole or not at all. Raises StorageError
    )
    from .surface.drawing_file import (
        checked_drawing,  # Return a CAD model's suffix; NominalError for one that cannot be read
    )
    from .surface.fusion import (
        FusedCloud,  # Points of one surface, in the object's frame; all arrays have the same length n
        PlacedScan,  # One scan and where it is: its points p are at rotation · p + translation in the object's frame
        fuse,  # Return one surface of all scans, a point about every spacing_mm. One scan is held at a time
    )
    from .surface.nominal import (
        nominal_of_mesh,  # Return a mesh as the surface that others are compared with
        read_nominal,  # Read a nominal surface in mm about a local origin. Raises NominalError
    )
    from .surface.object_mesh import (
        VOXEL_MM,  # Edge of a cell of a mesh, mm
        mesh_of_surface,  # Return the mesh of a fused surface, whose points should be about half a voxel apart
    )
else:
    __getattr__, __dir__, __all__ = lazy_face(__name__)
