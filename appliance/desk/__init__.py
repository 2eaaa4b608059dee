"""Work with stored scans at the desk: clouds, objects, comparison, reports, import, archives, Python."""

from __future__ import annotations

from typing import TYPE_CHECKING

from appliance.base import lazy_face

if TYPE_CHECKING:
    from .anew.season import (
        page_of_table,  # Return the page about the season of a table, and the number of its scans. Raises ResultsError
    )
    from .anew.work import (
        ArchiveWork,  # Reprocessing of an archive: its scans, settings and workers
    )
    from .cloud_files import (
        ObjectFiles,  # Files of a solved object; its surface and the mesh of that are made once, on first use
        write_cloud,  # Write the cloud of a stored scan, of two of the same scene as one
    )
    from .comparing import (
        compare_stored,  # Compare a scan (its folder), or the surface of a solved object
    )
    from .dive_report import (
        report_of_dive,  # Return the page's content for scans under a storage root
    )
    from .evaluation import (
        run_evaluation,  # Reconstruct and measure every scan of the list
    )
    from .export.formats import (
        ExportError,  # A file cannot be made; the text names it, the reason and the remedy
        check_file,  # Check before minutes of work that a file can be written
        has_triangles,  # Return whether a mesh is written to path; preferred: also if its suffix leaves the choice
    )
    from .foreign.first_look import (
        check_import,  # Check all that can be checked without decoding
        import_images,  # Import the images below a folder, or those that a description describes
    )
    from .measuring import (
        check_exposure,  # Return the ripple in the fringes of a stored scan. Raises ScanError
        noise_of_scan,  # Return, by side, the camera's noise in a stored scan and the noise that the rig file states
        noise_to_store,  # Return the results of noise_of_scan as figures of the instrument's cameras
        response_of_scan,  # Return the projector's response from the raw frames of a stored scan
    )
    from .object_report import (
        report_of_object,  # Return the page's content for a solved object, with its surface
    )
    from .object_store import (
        ADDED_SINCE,  # Reason of a scan that was added after the object was solved
        Places,  # Scan poses of an object, with the results of solving it
        StoredObject,  # An object: its scans, and their poses if it was solved
        object_exists,  # Return whether there is an object of that name
        object_names,  # Return the names of all objects under a storage root, in order
        read_object,  # Read an object. Raises ObjectError if it is missing or damaged
        read_solved_object,  # Read a solved object. Raises ObjectError for any other
    )
    from .objects import (
        add_to_object,  # Add scans, by their folders, to an object, which is created if needed
        solve_object,  # Find the pose of every scan of an object, store them, and return the object
        tell_health,  # Store the shared error that an object's overlaps show with the health of its calibration
    )
    from .reconstruct import (
        work_through,  # Reconstruct and judge a scan, one sequence or both. Raises ScanError
    )
    from .report.page import (
        write_report,  # Write the page, complete or not at all. Raises StorageError
    )
    from .surface.drawing_file import (
        check_drawing,  # Return a CAD model's suffix; NominalError for one that cannot be read
    )
else:
    __getattr__, __dir__, __all__ = lazy_face(__name__)
