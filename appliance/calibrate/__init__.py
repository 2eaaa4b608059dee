"""Calibrations in air and in water, and whether they still hold."""

from __future__ import annotations

from typing import TYPE_CHECKING

from appliance.base import lazy_face

if TYPE_CHECKING:
    from .air.any_board import (
        BoardDescription,  # Description of a board by its owner; None for each number that is to be found
    )
    from .air.board import (
        BoardDesign,  # ChArUco board: squares across and down, and the printed sizes
        NoBoard,  # Reason why a pair of images was not used, as a sentence for the holder of the board
    )
    from .air.coverage import (
        coverage,  # Return which image regions, distances and tilts the views cover, and which are missing
    )
    from .air.linearised import (
        BoardView,  # Corners of one board, seen by both cameras at the same moment
    )
    from .air.rest import (
        mean_of,  # Return the rounded mean (h, w) uint8 of pictures (n, h, w), which has less noise than each
        view_of,  # Return the board in pictures (n, h, w) uint8 that both cameras took one after the other
    )
    from .calibrations import (
        Calibrations,  # The calibration files of one instrument
        SessionError,  # Error of a request that does not fit the state of the session
    )
    from .files import (
        describe_calibration,  # Return the content of a calibration file as names and values for people
    )
    from .guide import (
        HELD,  # Artefact of each step that records one
        STEPS,  # Steps of the guided calibration in their order
        UNITS,  # Unit of the number that is shown with each refusal
        USED,  # Steps whose recordings the adjustment uses
        LengthCheck,  # Length check with a bar that the adjustment has not seen
        RecordingCheck,  # Judgement of the recording of one step; accepted where refusal is None
        Refusal,  # Reasons why a recording is not accepted
        Session,  # Progress of one calibration; its recordings are stored scans
        Step,  # Steps: four recordings, the adjustment, a recording that it has not seen, the decision
    )
    from .health import (
        LEARNT_SCANS,  # Scans from which each patch learns its reference
        OVERLAP_LIMIT,  # Score of an object's overlaps above which an alarm is raised
        THIRD_MODES,  # Names of the patterns of the third gap
        UNMEASURED,  # Methods of calibrations whose ports are not measured
        HealthFile,  # File of one calibration's trend. One process writes, any number may read
        HealthTrend,  # Reference, sum and latest scans of one calibration
        OverlapNews,  # Smooth depth error that the overlaps of one object show for all its scans
        TrendPoint,  # One judged scan in the trend
        accept_change,  # Return the trend after an accepted length check, with the latest state as normal
        add_overlap_news,  # Return the trend after an object was solved
    )
    from .in_air import (
        calibrate_folder,  # Calibrate in air from a folder of the instrument, and write the result
        calibrate_pictures,  # Calibrate any two cameras from a folder, and write the result
        find_boards,  # Find the board in every pair of the instrument's folder
        install,  # Put an air calibration in use; return its path and that of the former one
    )
    from .in_water import (
        check_list,  # Raise ListError for an artefact that cannot calibrate, before any work is done
        run_water_calibration,  # Reconstruct every scan of the list and calibrate
    )
    from .photon_transfer import (
        MeasuredNoise,  # Noise of one camera, measured from one scan
        NoiseError,  # Error of a scan that does not determine the noise
        measure_noise,  # Return the noise of the camera that recorded frames (n, h, w) uint8 at rest
    )
    from .pictures import (
        ViewFolder,  # A folder for views of one board by one instrument
    )
    from .projector_response import (
        CameraImages,  # Frames (n, h, w) uint8 of one camera, and pattern coordinates (h, w)
        MeasuredResponse,  # The projector's response as measured from one scan
        ResponseError,  # Error of a scan that does not determine the response
        measure_response,  # Return the response of the projector that lit a scan of a smooth surface
    )
    from .recordings import (
        ArtefactKind,  # Kind of the recorded artefact
        CamerasDiffer,  # Error of recordings by other cameras than those of the start, or by different ones
        CertificateMissing,  # Error of an artefact without a certificate, or of a certificate without a number
        NotConverged,  # Error of recordings that no calibration fits together
        RecordingError,  # Error of recordings that cannot be used for a calibration
    )
    from .third_eye import (
        FITTED_SCANS,  # Normal scans that the projector is fitted to
        ThirdEye,  # The projector as the first scans of a calibration show it
        judge_with_projector,  # Return trend, projector and judgement after one more scan
        third_eye_file,  # Return the file of one calibration's projector
    )
    from .water.method import (
        BEFORE_OPERATOR,  # Names of the models that the published method goes through
        Method,  # Methods of calibrating in water
    )
    from .water_steps import (
        Examination,  # Judgement of a recording, and of VERIFY the length check
        Solution,  # Calibration that follows from the recordings
        examine_recording,  # Judge a stored scan as a recording of a step
        plane_distance,  # Return the distance of the plane of a step (M3 or M4) in a working volume
        reject_nominal_start,  # Raise CalibrationError where an adjustment would start from the nominal rig unasked
        solve_calibration,  # Adjust to the session's recordings, and check the bar's length of VERIFY
        start_of,  # Return the calibration from which an adjustment in water starts
    )
else:
    __getattr__, __dir__, __all__ = lazy_face(__name__)
