"""Everything that is kept: formats and their promises, the library of scans, the rig file, and a stored scan processed
again."""

from __future__ import annotations

from typing import TYPE_CHECKING

from appliance.base import lazy_face

if TYPE_CHECKING:
    from .archive import (
        BesideFile,  # A calibration's or object's file that is another one in the source and in the target
        Copied,  # Outcomes for one scan that was to be written
        copy_beside,  # Copy calibrations and objects from one storage root to another
        finish_removals,  # Remove what is left of sources whose removal was interrupted
        make_shelves,  # Make the folders that scans come into
        pack_scan,  # Pack the scan in source as target, which is compared with it before it gets its name
        problems_of,  # Return what is wrong with a scan, by file
        remove_source,  # Remove the scan in source after everything in it was found in copy, byte for byte
        scan_folders,  # Return the folders of all scans on those shelves of root, in order. Raises StorageError
        unpack_scan,  # Unpack the scan in source as target: the folder that was packed, byte for byte
    )
    from .atomic import (
        Bytes,  # Content of a file in memory
        FileSystem,  # The operations that storage needs of a file system. Every call raises OSError on failure
        LocalFileSystem,  # The disk of this machine (POSIX)
        StorageError,  # The disk refused. path and the reason are in the text, and what to do
    )
    from .config import (
        ConfigError,  # The rig file cannot be used. headline fits a safe screen
        Rig,  # One instrument, as its rig file describes it. Checked when built: see appliance.store.config.checks
        default_rig_path,  # Return the rig file that is packaged with the product
        load_rig,  # Read and check a rig file. Raises ConfigError, never anything else, for whatever the file holds
        parse_rig,  # Read a rig from text like load_rig; source names it in messages
    )
    from .config.rig import (
        CameraRig,  # [camera.left] and [camera.right]
        OutputRig,  # [projector], and most of [display]: a connector of a graphics card, or a window on a desk
        ProjectorRig,  # [projector]
    )
    from .damage import (
        damaged_frames,  # Compare every byte of the frames with its checksum; empty where all are whole
        frames_as_they_are,  # Return the frames of a damaged file, (n, h, w) uint8
        refuse_damaged_frames,  # Compare every byte of a scan's frames with its checksum; ScanError if any differs
    )
    from .incomplete import (
        IncompleteRecording,  # An incomplete recording as it lies on disk
        find_incomplete,  # Return the folder of a recording by its number. Raises ScanError
        keep_incomplete,  # Make the first frames of a sequence durable, all or nothing, and return their folder
        load_incomplete,  # Open an incomplete recording; every byte is compared with its checksum. Raises ScanError
    )
    from .instrument import (
        Instrument,  # The instrument of a rig file
        load_calibration,  # Read a calibration file. Raises CalibrationError also for a missing or unreadable file
    )
    from .label import (
        LONGEST_NAME,  # Greatest lengths in characters: a name is a column of a list, a note a paragraph
        LONGEST_NOTE,  # Greatest lengths in characters: a name is a column of a list, a note a paragraph
        Label,  # Name and note of a scan; None: there is none
        checked_label,  # Return text in Unicode's composed form without blanks around it; None where nothing is left
        read_label,  # Return the label of a scan's folder; an empty one where there is none. Raises ContentError
    )
    from .library import (
        Library,  # The scans under one root. Raises StorageError for whatever the disk refuses
        LibraryFolder,  # Folders that a finished scan can lie in; the values are folder names
        PendingScan,  # A scan whose raw frames are durable and that waits for the diver's decision
        ScanEntry,  # One scan in the list. A damaged one is listed like the others, with its problems
        UnknownScan,  # There is no scan of that number
        entry_of,  # Return one scan by its folder, be it in a library or copied elsewhere
    )
    from .lock import (
        hold_lock,  # Hold the lock of root; StorageError if another process has it
        holder,  # Return the process that holds the lock of root; None where nobody does
    )
    from .manifest import (
        INCOMPLETE_MANIFEST_FILE,  # The file that stands in its place where a scan broke off (incomplete)
        MANIFEST_FILE,  # Name of that file
        Manifest,  # The whole manifest
        ScanRecord,  # Everything known about a scan but its files
        SecondSequence,  # A second sequence of the same scene with another exposure
        SequenceInfo,  # Pattern that each frame shows
        Stage,  # Stages that a scan goes through
        manifest_json,  # Return the content as JSON holds it. Raises TypeError as encode
    )
    from .names import (
        CALIBRATION_IN_AIR,  # Folder below a storage root with its calibrations, the file in it that is in use
        CALIBRATIONS,  # Folder below a storage root with its calibrations, the file in it that is in use
        CURRENT_CALIBRATION,  # Folder below a storage root with its calibrations, the file in it that is in use
        OBJECTS,  # Folder below a storage root with its objects
        NameShapeError,  # A name cannot be part of a path; the text says which and what is allowed
        by_number,  # Return what orders names of scans as they were taken, 1000000 after 999999
        component,  # Return name, which is one component of a path; NameShapeError otherwise
        is_kept_calibration,  # Return True if name is that of a kept calibration, and of nothing outside its folder
        is_object,  # Return True if name can name an object, whose folder and files are called so
    )
    from .object_numbers import (
        largest_number,  # Return the largest number that one of the newest scans carries, wherever it lies
        numbers_of_object,  # Return every number that a published scan carries, ascending
        scans_of_object,  # Return the published scans that belong to an object
    )
    from .origin import (
        Chosen,  # The calibration a scan is reconstructed with
        SourceScan,  # A stored scan and the instrument that took it
        calibration_for,  # Return the calibration for a scan: the one asked for, else its own
        instrument_of,  # Return the instrument that all scans (one or more) are of
        lost,  # Return what is wrong with one of a scan's files, its bytes compared with their checksum
        one_calibration,  # Return the calibration for several scans at once
        open_source,  # Open a scan and the rig it was taken with: --rig, else its own
        refuse_misfit,  # Raises CalibrationError where misfit has a reason. whose
    )
    from .packed import (
        PackedError,  # A packed file cannot be used; the text says why, without its path
    )
    from .picture_size import (
        KNOWN,  # Formats of pictures whose size is read, in words
        picture_head,  # Return width, height and bits that the header states
        size_px,  # Return the width and height that the header states; None as picture_head
    )
    from .ply import (
        encode_ply,  # Return the header and body of the file
        write_ply,  # Write a cloud for a desk, whole or not at all
    )
    from .pull.pulling import (
        pull_scans,  # Take what is finished at host and not here to the storage root out
    )
    from .reprocess import (
        ReprocessedScan,  # A stored scan after everything the instrument does with one
        refuse_empty,  # Raises ScanError where why_empty had a reason
        reprocess_bracket,  # Reconstruct and judge first and the frames of a second sequence as one
        reprocess_scan,  # Reconstruct and judge a stored scan with calibration, as the instrument does
        sequence_of_scan,  # Return the patterns it was recorded with
        water_of_scan,  # Return the water the scan was recorded in, as its manifest says
    )
    from .room import (
        Room,  # A file system whose new files are made of what is allocated
        plan_room,  # Return lengths in bytes of what one scan needs
    )
    from .root import (
        VARIABLE,  # Environment variable with the storage root
        standing_root,  # Return the storage root around the working directory, else that of KINGFISHER_ROOT
        where_none_was_found,  # Return where standing_root looked in vain, in words
    )
    from .scan import (
        CLOUD_FILE,  # Name of a scan's file of points
        PREVIEW_FILE,  # Name of a scan's picture
        RAW_FILES,  # Names of a scan's files of frames
        RIG_FILE,  # Name of a scan's rig file
        SECOND_FILES,  # Names of the files of frames of a second exposure
        ScanError,  # A stored scan cannot be used; the text says which and why
        ScanOrigin,  # The means a scan was taken with, as the bytes of the files that describe them
        StoredScan,  # A scan as it lies on disk. frames by side: (n, h, w) uint8, mapped
        cloud_bytes,  # Return the length that the file with the points has at most: one for every left pixel
        frames_bytes,  # Return the length of the file with one camera's frames
        frames_file,  # Name of the file with one camera's frames
        keep_scan,  # Make the scan folder outside of a library, whole or not at all
        load_scan,  # Open a scan; its files' lengths are checked
        manifest_of,  # Return the manifest of a scan's folder. Raises ScanError
        read_frame,  # Return frame k of one camera, (h, w) uint8, compared with its checksum
        second_frames_file,  # Name of the file with one camera's frames of the second exposure, where a scan has one
        size_bytes,  # Return the room one scan with one exposure needs at most
    )
    from .scan_list import (
        ListedScan,  # One scan of the list, and what it shows
        ListError,  # The list of scans cannot be used
        ScanList,  # A list of scans as the metrologist wrote it down
        read_list,  # Read a list, TOML or (by its name) JSON: docs/evaluation.md. Raises ListError
        refuse_repeats,  # Raise ListError for an artefact that a list names twice in one scan
    )
    from .wish import (
        Wish,  # The options that were given beside the scan itself; None: nothing was said
    )
else:
    __getattr__, __dir__, __all__ = lazy_face(__name__)
