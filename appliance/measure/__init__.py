"""The measuring core: images and a calibration become points, errors and verdicts.

It knows no file, clock, device or screen."""

from __future__ import annotations

from typing import TYPE_CHECKING

from appliance.base import lazy_face

if TYPE_CHECKING:
    from .accept.acceptance import (
        Certificate,  # Statements of an artefact's certificate besides its lengths; None: nothing
        Symbol,  # Quantities by the letters of the guideline
    )
    from .accept.ball_bar import (
        BallBar,  # Two balls, the one with the smaller x first
        find_ball_bar,  # Return the two balls of nearly equal radius that most of a cloud's points agree on
    )
    from .accept.flatness import (
        REFERENCE_MM,  # d_r: a constant of the instrument, fixed by its measuring field
        Flatness,  # Flatness of a measured plane, as parts of d_r (1 is 100 %)
        flatness,  # Return E_F, E_F,sys and noise of a plane; the 0.3 % outliers are out already
    )
    from .accept.plane import (
        PlaneFit,  # A plane found in a cloud and the points it rests on
        fit_plane,  # Return the plane that most of the cloud lies on
    )
    from .accept.points import (
        NotFound,  # Reason why there is no result, in one sentence for the person who holds the artefact
        PointSource,  # Points in the left camera frame; appliance.measure.points.table.Cloud is one
    )
    from .accept.report import (
        Evaluation,  # All scans and what they have in common
        Item,  # One scan of the evaluation, with where it came from
    )
    from .accept.result import (
        LENGTHS,  # The calibrated lengths that an artefact may have
        Artefact,  # Artefacts that can be evaluated
        evaluate,  # Find an artefact in a cloud and compare it with its calibrated lengths
    )
    from .bracket import (
        ProcessedSequence,  # One of the two sequences after its full cloud
    )
    from .calibration.depth_error import (
        BORDER,  # x/z at the border of the view
        DEPTH_ERROR_TERMS,  # Number of coefficients of the smooth depth error
        DISTANCE_MM,  # Distance in the standard housing at which coefficients are mm
        POWERS,  # Exponents i, j, k of u, v and w. What is constant or tilts only moves or turns a scan
        along_ray,  # Return the vectors (…, 3) by which points move per mm of depth
        shapes,  # Return φ (…, COUNT) at points (…, 3) of a scan's own frame
    )
    from .calibration.design import (
        METHOD,  # Method of a calibration that is the drawing
        Design,  # The optical design: two equal cameras, toed in symmetrically
        design_calibration,  # Return the calibration of an instrument built exactly to the drawing
    )
    from .calibration.field import (
        AirField,  # The lenses' fields as boards in air tell of them, together with all else
    )
    from .calibration.file import (
        CALIBRATION,  # File of a calibration
        IN_AIR,  # Method of a calibration in air, which only calibrating in water begins with
        Calibration,  # The instrument as measured. hash identifies it in every scan made with it
        CalibrationError,  # A calibration file cannot be used; the text says which, why and what to do
        decode_calibration,  # Parse and check a file's bytes. Raises CalibrationError naming name, the key
        encode_calibration,  # Return the file's bytes
    )
    from .calibration.gaps import (
        MODES,  # Names of the patterns of ray gaps that a calibration cannot tell from water or pose
        TURNS,  # Names of the right camera's turns, as changes
        GapModes,  # The four patterns of ray gaps of one calibration in one water
        in_words,  # Return a turn of the right camera in a technician's words
    )
    from .calibration.noise_file import (
        LIMITS,  # Range of each figure, within that of the rig file's key of the same name
        NOISE,  # File of the cameras' measured noise
        BothFigures,  # The figures of both cameras
        CameraFigures,  # One camera's figures as the rig file has them, measured instead of read in a data sheet
        StoredNoise,  # The noise of both cameras and where it comes from
    )
    from .calibration.owner import (
        Misfit,  # Reason why a calibration is not of an instrument
        Owner,  # An instrument, as a rig file or a stored scan states it
        exchanged,  # Return which cameras are not those of the calibration; None: they are, or nobody knows
        owner_misfit,  # Return why calibration is not of owner; None where it is, as far as is known
    )
    from .calibration.parameters import (
        RIG_PARAMETERS,  # Names of the parameters of a rig that a covariance is of
    )
    from .calibration.patches import (
        true_matches,  # Return which values are no outliers of their patches
    )
    from .calibration.response_file import (
        RESPONSE,  # File of the projector's measured response
        StoredResponse,  # A response and where it comes from. Raises ValueError for harmonics that no response has
    )
    from .cloud import (
        CloudSummary,  # Numbers of a cloud that the diver and the manifest are told
        Found,  # A found cloud: where in the table its points are, and what describes it
        PatchGaps,  # Mean signed ray gaps of one scan
    )
    from .decode.decoder import (
        CameraDecoder,  # Decodes one camera's sequence as its frames arrive
        Mask,  # Reason why a pixel has no coordinates; the first that applies
    )
    from .decode.phase import (
        choose_fringes,  # Write the places in px of the best fringes that begin before end_px
        fit_steps,  # Fit sines to images (n, h, w), of any type of numbers, by weights (3, n), which make A
    )
    from .fault import (
        Fault,  # One case of a fault: what, in the detector's words, with its numbers, and of which device if of one
        FaultCode,  # One name per distinguishable fault. In brackets: the numbers its headline shows
    )
    from .guidance import (
        Guidance,  # The overlap that a scan taken from here would have with the one that was kept last
        Move,  # The thing to do before the next scan
        Overlap,  # Overlap of a scan with the one before
    )
    from .judges import (
        JUDGES,  # Judges in the order in which their verdicts are told and stored
    )
    from .light.acquisition import (
        AcquisitionSettings,  # Settings that a sequence is taken with
    )
    from .light.correction import (
        SplineGrid,  # The nodes of a bicubic B-spline over an image; they count row by row
    )
    from .light.draw import (
        draw_sequence,  # Return every pattern of a sequence in the order of projection, (height, width) uint8 each
    )
    from .light.epipolar import (
        CurveError,  # The depths that were asked for have no curves; says which depths would do
    )
    from .light.exposure import (
        NOMINAL,  # Exposure of an instrument whose rig file nobody has read
        STEPS_MS,  # Exposure times, about a quarter more light each
        Exposure,  # Exposure of both cameras, which share one trigger pulse
        Span,  # Exposures that may be proposed, whatever the projector's period allows
        ladder,  # Return all steps from dark to bright for a projector's vertical period
    )
    from .light.model import (
        HousedCamera,  # A camera in its housing, at its place in the left camera frame
        StereoRig,  # Both cameras; the left one's frame is the frame of everything measured
    )
    from .light.noise import (
        FULL_DN,  # Largest grey value of a camera's eight bits
        MAD_TO_SIGMA,  # Standard deviation over the median distance from the mean, of normal values
        TYPICAL_PAIR,  # Noise of two cameras of which nothing is known
        CameraNoise,  # One camera's temporal noise: variance = read_dn² + dn_per_e · (grey value − black_dn)
        StereoNoise,  # The temporal noise of both cameras
        camera_noise,  # Build the noise model from a data sheet's figures after EMVA 1288
    )
    from .light.patterns import (
        BRIGHT_CODE,  # Code of white
        DARK_CODE,  # Code of black
        PERIODS_PX,  # Periods of fringes that sequences are built for, px
        STEP_ORDERS,  # Orders in which a sequence may project its steps of 90°: that of the instrument, and the rising one
        Direction,  # The pattern coordinate along which a pattern varies
        Kind,  # What a pattern shows
        Pattern,  # One frame of the sequence. index is the Gray bit (0 = most significant) or the sine step (0..3)
        PatternSequence,  # All patterns of a scan in the order of projection
        build_sequence,  # Return the sequence for a fringe period
    )
    from .light.pinhole import (
        FoldingLens,  # A lens of others, whose distortion may fold over within the image
        Lens,  # A pinhole with distortion. Normalised coordinates are x = X/Z, y = Y/Z in the camera frame
    )
    from .light.port import (
        Port,  # A plane-parallel window in front of a camera
    )
    from .light.response import (
        Response,  # One projector's response. Raises ValueError where light does not grow with the code
        phase_error_rad,  # Return the largest error of a four-step phase on fringes with these harmonics, in radians
    )
    from .light.rotation import (
        matrix3,  # Return a rotation matrix (3, 3) as the immutable value that a HousedCamera keeps
        rotation_matrix,  # Return the rotation matrix (3, 3) that turns about the direction of vector_rad (3,)
        rotation_vector,  # Return the vector (3,), rad, of a rotation matrix, for turns of less than 180°
    )
    from .light.sides import (
        SIDES,  # The two cameras, left as the diver sees it
        of_side,  # Return the part of both that belongs to the camera side
    )
    from .light.sine import (
        PHASE_STEPS,  # Number of phase steps, 90° apart; PatternSequence says what relies on it
    )
    from .light.volume import (
        STANDARD,  # The volume of the standard housing: of rig files and calibrations that say nothing else
        STANDARD_MM,  # Working distance of the housing that this software's lengths were found on
        WorkingVolume,  # The range in which a housing measures; by default that of the standard housing
    )
    from .light.water import (
        Water,  # The water around the instrument, and the wavelength of the light that travels through it
    )
    from .motion.projector import (
        ShownPoints,  # Points of one scan, and what the projector showed there
        fit_projector_to,  # Fit the projector to the points of several scans
    )
    from .news import (
        Bracket,  # Outcome of a second exposure: the cloud of both, or the fault for which there is none
        CoarseCloud,  # Cloud of every few pixels
        FullCloud,  # Cloud of every pixel, with the final judgements of the scan
        LiveGuidance,  # Guidance by a live picture. It belongs to no sequence: a scan that begins ends it
        News,  # Envelope of a fact
        PatternIdentity,  # Judgement whether each frame shows the pattern it should. With a fault
        ReconstructionFailure,  # Fault for which the frames get no points now; the next scan's may
        ScanOverlap,  # Overlap of the scan with the one before of its object, found some time after the full cloud
        SequenceFact,  # Every fact about one sequence
        Verdicts,  # All judgements of the scan, identity first, in place of those before
        WorkerFailure,  # Failure of the worker's process, in words
        WorkProgress,  # One step more of the work, of which nothing else is to be told
    )
    from .overlap.equations import (
        FEWEST,  # Fewest patches in common
        System,  # The equations of one round
    )
    from .overlap.fine import (
        Fit,  # A fine pose with what is known about it
    )
    from .overlap.next_view import (
        Guide,  # Follows live pictures of one kept scan after another. Used by one thread
        Sight,  # The camera that aims, in its water
    )
    from .overlap.overlap import (
        CoarseView,  # A scan as it is compared under water. What takes time is made when it is first asked for
        coarse_view,  # Keep what a scan is compared by. cloud: every stride_px-th pixel's point
        compare,  # Find how much of b lies on a
    )
    from .overlap.pair import (
        PairRefusal,  # Reason why two scans are not placed relative to each other
        ReadyScan,  # A scan as registration wants it; made once per scan
        RegisteredPair,  # Two scans that were compared, and what came of it
        ready,  # Prepare a scan for registration
        register,  # Find the pose of B in A's frame
    )
    from .overlap.patches import (
        projection_of,  # Fit the projection of a camera in water of water_index to its own refracted rays
    )
    from .overlap.rigid import (
        Rigid,  # A rigid motion: x' = rotation x + translation_mm
    )
    from .points.first_direction import (
        first_direction_cloud,  # Return the cloud of a sequence's frames up to the last of X
    )
    from .points.maps import (
        CoordinateMap,  # Coordinates of one direction of the pattern in one image, without edges, with their noise
        pixels_without_ray,  # Tell (h, w) which pixels have no ray
        points_of_maps,  # Return the points where rays meet, without any limit
    )
    from .points.one_direction import (
        UNCHECKED,  # The note that every file of such a cloud carries
        NoPoint,  # Reason why a left pixel has no point; the first that applies
        OneDirectionLimits,  # Limits of a search. What is None follows from the maps themselves
        match_along_curves,  # Find the point of each left pixel whose coordinate lies on its epipolar curve
    )
    from .points.organised import (
        OrganisedCloud,  # A full cloud of one scan, left camera frame
        no_points,  # Return a cloud without points on the grid of the image grey, (h, w) uint8, to be filled in
        organised,  # Lay the points of cloud on the grid of the left camera's bright frame, (h, w) uint8
    )
    from .points.pipeline import (
        COARSE_POINTS,  # Number of left pixels asked for the coarse cloud
        Pipeline,  # A reconstruction of scans of one sequence with one calibration in one water
        coarse_stride_px,  # Return the distance of a coarse cloud's points in a left image of that size
    )
    from .points.quality import (
        QualityLimits,  # A point outside of any limit is masked, never moved or invented
    )
    from .points.straighten import (
        measure_bend,  # Measure it in all coordinates of the cameras at once; STRAIGHT where too few pixels have any
    )
    from .points.table import (
        CLOUD_BYTES,  # Bytes of one point of a Cloud
        POINT_BYTES,  # Bytes of one point in a table
        Cloud,  # Points in the left camera frame, with what is known about each. All arrays have the same length n
        PointTable,  # Room for capacity points in memory (POINT_BYTES each), or in memory of its own
    )
    from .procedure import (
        SequenceProcessor,  # Takes one sequence after the other through pipeline and past the judges
    )
    from .verdict import (
        GRADE_NAME,  # Name of the verdict whose text is the grade's value
        LENGTHS_DOUBTFUL,  # Name of the number that is 1 where lengths were not to be trusted
        MADE_UP_FOR,  # Faults of one sequence that a second one with another exposure makes up for
        SPOILS_POINTS,  # Faults that make points of a recorded scan wrong
        SPOILS_SCAN,  # Faults that make a recorded scan worthless: it is not kept
        Grade,  # The verdict on a scan
        Judgement,  # A verdict, and the fault to tell the diver of
        Verdict,  # One judgement with its numbers; passed is None where there was nothing to judge
        faults_in,  # Return the faults of judgements, in their order
        faults_of_both,  # Return the faults of a scan of two exposures
        grade,  # Return the grade of a scan whose cloud covers so much of what is lit, with that median sigma
    )
    from .verdicts.causes import (
        CAUSES_NAME,  # Name of the verdict causes
    )
    from .verdicts.identity.judge import (
        IDENTITY_NAME,  # Name of the verdict identity
    )
    from .verdicts.window import (
        CELLS,  # Columns and rows of cells over each image
        SLACK,  # A fall that every cell is forgiven
        Windows,  # One scan. By side left and right; arrays (CELLS[0] · CELLS[1],), cells by row
    )
    from .warm import (
        PIECES,  # Everything that a scan may need, just recorded or stored
        POINT_PIECES,  # All that points need where the images were decoded by something else
        compiler_watched,  # Watch numba; yields what tells whether it had to compile
        what_an_empty_scan_does_not_run,  # Return what runs the kernels for bent fringes, changing light
    )
else:
    __getattr__, __dir__, __all__ = lazy_face(__name__)
