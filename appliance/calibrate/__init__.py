"""Making a calibration, in air and in water, and telling whether it still holds."""

from __future__ import annotations

from typing import TYPE_CHECKING

from appliance.base import lazy_face

if TYPE_CHECKING:
    from .air.any_board import (
        Wanted,  # The owner's description of a board; None where it is to be found
    )
    from .air.board import (
        BoardDesign,  # A ChArUco board: squares across and down, and the printed sizes
        NoBoard,  # Reason why a pair of images was not used, in a sentence for the person who holds the board
    )
    from .air.coverage import (
        coverage,  # Determine what views cover and what they lack
    )
    from .air.linearised import (
        BoardView,  # One board seen by both cameras at once
    )
    from .air.rest import (
        mean_of,  # Return the mean (h, w) uint8 of pictures (n, h, w), rounded: less noise than each has
        view_of,  # Return the board in pictures (n, h, w) uint8 that both cameras took one after the other
    )
    from .calibrations import (
        Calibrations,  # The calibrations of one instrument. Raises StorageError for whatever the disk refuses
        SessionError,  # A request does not go with the session as it is; the text says why and what to do
    )
    from .calibrator import (
        Examined,  # A recording, judged; with what it says about lengths if it verifies
        Solution,  # The calibration that the recordings gave
        examine_recording,  # Judge a stored scan as a recording of step
        plane_place,  # Return where the plane of step (M3 or M4) belongs before a housing of that volume
        refuse_drawing,  # Raise CalibrationError where a calibration would begin with the drawing unasked
        solve_calibration,  # Adjust to the scans of the session; compare with the one of VERIFY where there is one
        start_of,  # Return what a calibration in water begins with
    )
    from .files import (
        describe_calibration,  # Return what a calibration says
    )
    from .guide import (
        HELD,  # The steps with a recording, and what is held before the instrument
        STEPS,  # Steps of the guided calibration in their order
        UNITS,  # Unit of the number that is shown with a refusal
        USED,  # The recordings that the adjustment uses
        RecordingCheck,  # One recording of one step, judged. refusal None: it will do
        Refusal,  # Reasons why a recording will not do
        Session,  # Progress of one calibration. Its recordings are stored scans
        Step,  # Steps in their order: four recordings, the adjustment, a fifth recording that it has not seen
        Verified,  # The length of a bar that the adjustment has not seen
    )
    from .health import (
        LEARNT_SCANS,  # Scans that teach a patch its reference
        OVERLAP_LIMIT,  # Score of an object's overlaps that alarms
        THIRD_MODES,  # Names of the patterns of the third gap
        UNMEASURED,  # Methods of calibrations whose ports nobody measured: their rays miss each other anyway
        HealthFile,  # The memory of one calibration. One process writes, any number may read
        HealthTrend,  # Everything remembered about one calibration
        OverlapNews,  # What one object's overlaps say of the smooth depth error
        TrendPoint,  # One judged scan
        answered,  # Return the trend after an accepted length check
        told_by_overlaps,  # Return the trend after an object was solved
    )
    from .in_air import (
        calibrate_folder,  # Calibrate in air from a folder, write out and beside it both pictures
        calibrate_pictures,  # Calibrate the cameras name from pictures, write out and what goes beside it
        find_boards,  # Look at every pair. Raises PicturesError, ScanError
        install,  # Make a calibration in air the instrument's: where it lies, and where the one before it now does
    )
    from .in_water import (
        check_list,  # Raises ListError for what cannot calibrate, before the work is done
        run_water_calibration,  # Reconstruct every scan of the list and calibrate
    )
    from .photon_transfer import (
        MeasuredNoise,  # One camera's noise as a scan shows it
        NoiseError,  # A scan does not tell the noise; the text says why and what to do
        measure_noise,  # Return the noise of the camera that recorded frames (n, h, w) uint8
    )
    from .pictures import (
        ViewFolder,  # A folder for views of one board by one instrument
    )
    from .projector_response import (
        CameraImages,  # Images of one camera: frames (n, h, w) uint8 of the whole sequence
        MeasuredResponse,  # Projector response as one scan shows it
        ResponseError,  # A scan does not tell the response; the text says why and what to do
        measure_response,  # Return the response of the projector that lit a scan of a smooth surface
    )
    from .recordings import (
        ArtefactKind,  # Kind of the recorded artefact
        CamerasDiffer,  # The recordings are not of the cameras that the calibration starts from
        CertificateMissing,  # The artefact's certificate, or a number of it, is not stated
        NotConverged,  # The recordings can be used one by one, and no calibration fits all of them
        RecordingError,  # Recordings cannot be used for a calibration; the text says which, why and what to do
    )
    from .third_eye import (
        FITTED_SCANS,  # Normal scans that the projector is fitted to
        ThirdEye,  # The projector as a calibration's first scans show it
        judge_with_projector,  # Return trend and projector after one more scan, and what is to be said about it
        third_eye_file,  # Return the file of one calibration's projector
    )
    from .water.method import (
        BEFORE_OPERATOR,  # Names of the models that the published way goes through
        Method,  # Methods of calibrating in water
    )
else:
    __getattr__, __dir__, __all__ = lazy_face(__name__)
