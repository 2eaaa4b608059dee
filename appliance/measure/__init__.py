"""The measuring core: images and a calibration become points, errors and verdicts.

It knows no file, clock, device or screen."""

from __future__ import annotations

from typing import TYPE_CHECKING

from appliance.base import lazy_face

if TYPE_CHECKING:
    from .accept.acceptance import (
        Certificate,  # The data of an artefact's certificate besides its lengths; None: not stated
        Symbol,  # Quantities by the letters of the guideline
    )
    from .accept.ball_bar import (
        BallBar,  # Two balls, the one with the smaller x first
        find_ball_bar,  # Return the two balls of nearly equal radius (5..40 mm) that most points support
    )
    from .accept.flatness import (
        REFERENCE_MM,  # d_r: a constant of the instrument, fixed by its measuring field
        Flatness,  # Flatness of a measured plane, as fractions of d_r (1 is 100 %)
        flatness,  # Return E_F, E_F,sys and noise of a plane whose outliers (0.3 %) have been removed
    )
    from .accept.plane import (
        PlaneFit,  # A plane in a cloud and its points
        fit_plane,  # Return the plane on which most of the cloud lies, with at most 0.3 % outliers. Deterministic
    )
    from .accept.points import (
        NotFound,  # Reason why there is no result, in one sentence for the person with the artefact
        PointSource,  # Points in the left camera frame; appliance.measure.points.table.Cloud is one
    )
    from .accept.report import (
        Evaluation,  # All scans and their common data
        Item,  # One scan of the evaluation, with its source
    )
    from .accept.result import (
        LENGTHS,  # Names of the calibrated lengths of each artefact
        Artefact,  # Artefacts that can be evaluated
        evaluate,  # Find artefact in cloud and compare it with its calibrated lengths and limits_mm
    )
    from .bracket import (
        ProcessedSequence,  # One of the two sequences after its full cloud
    )
    from .calibration.depth_error import (
        BORDER,  # x/z at the border of the view
        DEPTH_ERROR_TERMS,  # Number of coefficients of the smooth depth error
        DISTANCE_MM,  # Distance in the standard housing to which the coefficients refer
        POWERS,  # Exponents i, j, k of u, v and w
        along_ray,  # Return the displacements (…, 3) of points per mm of depth error
        shapes,  # Return φ (…, COUNT) at points (…, 3) of a scan's frame: depth error in mm per mm of coefficient
    )
    from .calibration.design import (
        METHOD,  # Method of a calibration that is the drawing
        Design,  # The optical design: two equal cameras with symmetric toe-in, each behind a perpendicular port
        design_calibration,  # Return the calibration of an instrument as designed; its method is design
    )
    from .calibration.field import (
        AirField,  # The image corrections of both lenses from air, with the rig parameters
    )
    from .calibration.file import (
        CALIBRATION,  # File of a calibration
        IN_AIR,  # Method of a calibration in air, which is the start of a water calibration and nothing else
        Calibration,  # The instrument as measured. hash identifies it in every scan made with it
        CalibrationError,  # A calibration file cannot be used; the text says which, why and the remedy
        decode_calibration,  # Parse and check a file's bytes
        encode_calibration,  # Return the file's bytes
    )
    from .calibration.gaps import (
        MODES,  # Names of the patterns of ray gaps that a calibration cannot tell from water or pose
        TURNS,  # Names of the right camera's turns, as changes
        GapModes,  # The four patterns of one calibration in one water. Amplitudes are µm RMS over the working volume
        in_words,  # Return a rotation of the right camera in a technician's words
    )
    from .calibration.noise_file import (
        LIMITS,  # Allowed range of each figure, within that of the rig file's key of the same name
        NOISE,  # File of the cameras' measured noise
        BothFigures,  # The figures of both cameras
        CameraFigures,  # One camera's measured noise figures, with the names of the rig file
        StoredNoise,  # The noise of both cameras and its source
    )
    from .calibration.owner import (
        Misfit,  # Reason why a calibration does not belong to an instrument
        Owner,  # An instrument, as a rig file or a stored scan states it
        exchanged,  # Return which cameras are not those of the calibration; None if no difference is known
        owner_misfit,  # Return why calibration does not belong to owner; None if no difference is known
    )
    from .calibration.parameters import (
        RIG_PARAMETERS,  # Names of the parameters of a rig that a covariance is of
    )
    from .calibration.patches import (
        true_matches,  # Return which of values (n,) are inliers, the patches with enough of them, and their errors
    )
    from .calibration.response_file import (
        RESPONSE,  # File of the projector's measured response
        StoredResponse,  # A response and its source. Raises ValueError for impossible harmonics
    )
    from .cloud import (
        CloudLocation,  # A cloud in a table: the place of its points, and its description
        CloudSummary,  # Numbers of a cloud for the diver and the manifest
        PatchGaps,  # Mean signed ray gaps of one scan, before any quality limit
    )
    from .decode.decoder import (
        CameraDecoder,  # Decodes one camera's sequence as its frames arrive; the buffers are reused scan after scan
        Mask,  # Reason why a pixel has no coordinates; the first that applies
    )
    from .decode.phase import (
        choose_fringes,  # Write the places in px of the best fringes that begin before end_px, and their disagreement
        fit_steps,  # Fit sines to images (n, h, w) by weights (3, n), which give A, C and S
    )
    from .fault import (
        Fault,  # One case of a fault: code, the detector's words, numbers, and the device, if it is of one
        FaultCode,  # One name per distinguishable fault. In brackets: the numbers in its headline
    )
    from .guidance import (
        Guidance,  # The overlap that a scan from here would have with the kept one, and the direction to a better one
        Move,  # The next move of the diver before a scan
        Overlap,  # Overlap of a scan with the one before
    )
    from .judges import (
        JUDGES,  # Judges in the order in which their verdicts are reported and stored
    )
    from .light.acquisition import (
        AcquisitionSettings,  # Settings with which a sequence is captured
    )
    from .light.correction import (
        SplineGrid,  # The nodes of a bicubic B-spline over an image, numbered row by row
    )
    from .light.draw import (
        draw_sequence,  # Return every pattern of a sequence in order, (height, width) uint8
    )
    from .light.epipolar import (
        CurveError,  # The depths have no curves; the text says which depths have some
    )
    from .light.exposure import (
        NOMINAL,  # Exposure of an instrument without a rig file
        STEPS_MS,  # Exposure times, about a quarter more light each
        Exposure,  # Exposure of both cameras, which share one trigger pulse
        Span,  # The exposures that may be proposed, before the limit by the projector's period
        ladder,  # Return all exposures from dark to bright that fit a projector's vertical period
    )
    from .light.model import (
        HousedCamera,  # A camera in its housing. rotation and translation_mm map its frame into the left camera frame
        StereoRig,  # Both cameras; the left one's frame is that of all measurements
    )
    from .light.noise import (
        FULL_DN,  # Largest grey value of a camera's eight bits: a pixel with it is saturated
        MAD_TO_SIGMA,  # Standard deviation over the median distance from the mean, of normal values
        TYPICAL_PAIR,  # Noise of two cameras of which nothing is known
        CameraNoise,  # One camera's temporal noise: variance = read_dn² + dn_per_e · (grey value − black_dn)
        StereoNoise,  # The temporal noise of both cameras
        camera_noise,  # Return the noise model from the figures of a data sheet after EMVA 1288, both at 0 dB
    )
    from .light.patterns import (
        BRIGHT_CODE,  # Code of white
        DARK_CODE,  # Code of black
        PERIODS_PX,  # Periods of fringes that sequences are built for, px
        STEP_ORDERS,  # Orders in which a sequence may project its steps of 90°
        Direction,  # The pattern coordinate along which a pattern varies
        Kind,  # What a pattern shows
        Pattern,  # One frame of the sequence. index is the Gray bit (0 = most significant) or the sine step (0..3)
        PatternSequence,  # All patterns of a scan in the order of projection
        build_sequence,  # Return the sequence for a fringe period
    )
    from .light.pinhole import (
        FoldingLens,  # A foreign lens whose distortion may fold over within the image
        Lens,  # A pinhole with distortion. Normalised coordinates are x = X/Z, y = Y/Z in the camera frame
    )
    from .light.port import (
        Port,  # A plane-parallel port in front of a camera
    )
    from .light.response import (
        Response,  # One projector's response. Raises ValueError if light does not grow with the code
        phase_error_rad,  # Return the largest error of a four-step phase on fringes with these harmonics, in radians
    )
    from .light.rotation import (
        matrix3,  # Return a rotation matrix (3, 3) as the immutable value that a HousedCamera keeps
        rotation_matrix,  # Return the rotation matrix (3, 3) about the direction of vector_rad (3,)
        rotation_vector,  # Return the vector (3,), rad, of a rotation matrix, for rotations of less than 180°
    )
    from .light.sides import (
        SIDES,  # The cameras, left as the diver sees it
        of_side,  # Return the part of pair for the camera side; raises ValueError unless that is left or right
    )
    from .light.sine import (
        PHASE_STEPS,  # Number of phase steps, 90° apart; see PatternSequence
    )
    from .light.volume import (
        STANDARD,  # The volume of the standard housing: the default of rig files and calibrations
        STANDARD_MM,  # Working distance of the standard housing; WorkingVolume.scaled scales its lengths to another
        WorkingVolume,  # The range in which a housing measures; by default that of the standard housing
    )
    from .light.water import (
        Water,  # The water around the instrument, and the wavelength of the light in it
    )
    from .motion.projector import (
        ShownPoints,  # Points of one scan, and what the projector showed there
        fit_projector_to,  # Fit the projector to the points of several scans
    )
    from .news import (
        Bracket,  # Result of a bracket: the cloud of both exposures, or a fault
        CoarseCloud,  # Cloud of every few pixels
        FullCloud,  # Cloud of every pixel, with the final judgements of the scan
        LiveGuidance,  # Guidance by a live image. It belongs to no sequence, and ends when a scan begins
        News,  # Envelope of a fact
        PatternIdentity,  # Judgement whether each frame shows its pattern
        ReconstructionFailure,  # Fault for which these frames get no points; the next scan may
        ScanOverlap,  # Overlap of the scan with the one before of its object, some time after the full cloud
        SequenceFact,  # Every fact about one sequence
        Verdicts,  # All judgements of the scan, identity first, instead of the earlier ones
        WorkerFailure,  # Failure of the worker's process, in its last words or those of its parent
        WorkProgress,  # One step of the work without a result of its own: a judge, or a step of a second exposure
    )
    from .overlap.equations import (
        FEWEST,  # Fewest corresponding patches
        System,  # The equations of one round
    )
    from .overlap.fine import (
        Fit,  # A fine pose, its uncertainty and its agreement
    )
    from .overlap.next_view import (
        Guide,  # Compares live images with one kept scan after another. Used by one thread
        Sight,  # The camera that aims, in its water
    )
    from .overlap.overlap import (
        CoarseView,  # A scan as it is compared under water; costly parts are computed on demand
        coarse_view,  # Return the view of a scan by which it is compared
        compare,  # Yield None after each piece of work of at most 0.1 s, and the overlap of b with a last
    )
    from .overlap.pair import (
        PairRefusal,  # Reason why two scans are not placed relative to each other
        ReadyScan,  # A scan that is prepared for registration
        RegisteredPair,  # The result of registering two scans
        ready,  # Prepare a scan for registration
        register,  # Find the pose of B in A's frame; near: an approximate pose, such as that of other pairs
    )
    from .overlap.patches import (
        projection_of,  # Fit the projection of a camera in water to its refracted rays
    )
    from .overlap.rigid import (
        Rigid,  # A rigid transform: x' = rotation x + translation_mm
    )
    from .points.first_direction import (
        first_direction_cloud,  # Return the unchecked cloud of a sequence's frames up to the last of X
    )
    from .points.maps import (
        CoordinateMap,  # Coordinates of one direction of the pattern in one image, without edges, with their noise
        pixels_without_ray,  # Return a mask (h, w) of the pixels that have no ray
        points_of_maps,  # Return the points where rays meet, without any limit
    )
    from .points.one_direction import (
        UNCHECKED,  # The note that every file of such a cloud carries
        NoPoint,  # Reason why a left pixel has no point; the first that applies
        OneDirectionLimits,  # Limits of a search; those that are None follow from the maps
        match_along_curves,  # Find the point of each left pixel whose coordinate is on its epipolar curve
    )
    from .points.organised import (
        OrganisedCloud,  # A full cloud of one scan, left camera frame
        no_points,  # Return a cloud without points on the grid of grey, (h, w) uint8, to be filled in
        organised,  # Return cloud on the grid of the left camera's bright frame, (h, w) uint8
    )
    from .points.pipeline import (
        COARSE_POINTS,  # Number of left pixels in the grid of the coarse cloud
        Pipeline,  # Reconstructs scans of one sequence with one calibration in one water; reusable, not thread-safe
        coarse_stride_px,  # Return the distance of a coarse cloud's points in a left image of that size
    )
    from .points.quality import (
        QualityLimits,  # Limits of a point; a point outside of any limit is masked, never moved or invented
    )
    from .points.straighten import (
        measure_bend,  # Measure the phase error in all coordinates of the cameras; STRAIGHT if there are too few
    )
    from .points.table import (
        CLOUD_BYTES,  # Bytes of one point of a Cloud
        POINT_BYTES,  # Bytes of one point in a table
        Cloud,  # Points in the left camera frame with their attributes. All arrays have the same length n
        PointTable,  # Memory for capacity points, of its own or in memory (POINT_BYTES each)
    )
    from .procedure import (
        SequenceProcessor,  # Takes one sequence after the other through pipeline and the judges
    )
    from .verdict import (
        EXPOSURE_FAULTS,  # Faults of one sequence that a second one with another exposure corrects
        GRADE_NAME,  # Name of the verdict whose text is the grade's value
        LENGTHS_DOUBTFUL,  # Name of that verdict's number that is 1 if lengths were doubtful at the time of the scan
        SPOILS_POINTS,  # Faults that make points of a recorded scan wrong
        SPOILS_SCAN,  # Faults that make a recorded scan worthless: it is not kept
        Grade,  # The verdict on a scan
        Judgement,  # A verdict, and the fault to report to the diver; None: no fault
        Verdict,  # A verdict with its numbers; passed is None if it was not judged
        faults_in,  # Return the faults of judgements, in their order
        faults_of_both,  # Return the faults of a bracket, given those of either sequence and of both together
        grade,  # Return the grade of a scan by its coverage, median sigma and faults
    )
    from .verdicts.causes import (
        CAUSES_NAME,  # Name of the verdict causes
    )
    from .verdicts.identity.judge import (
        IDENTITY_NAME,  # Name of the verdict identity
    )
    from .verdicts.window import (
        CELLS,  # Columns and rows of cells over each image
        SLACK,  # Loss of contrast that is allowed in every cell
        Windows,  # Contrast of one scan by side left and right; arrays (CELLS[0] · CELLS[1],), cells by row
    )
    from .warm import (
        PIECES,  # The pieces for every scan, just recorded or stored
        POINT_PIECES,  # The pieces for points of images that were decoded elsewhere
        remaining_kernels,  # Return functions that run the kernels which an empty scan does not run
        watch_compiler,  # Watch numba inside of the context
    )
else:
    __getattr__, __dir__, __all__ = lazy_face(__name__)
