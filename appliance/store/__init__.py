"""The store: file formats, the library of scans, the rig file, and reprocessing of stored scans."""

from __future__ import annotations

from typing import TYPE_CHECKING

from appliance.base import lazy_face

if TYPE_CHECKING:
    from .archive import (
        ArchiveReport,  # Outcome of packing or unpacking a storage root
        pack_archive,  # Pack the scans of the storage root source into archive, which is made
        unpack_archive,  # Unpack scans of an archive by their numbers, by default all
        verified_entry,  # Return the entry of a scan's folder after reading every byte and decoding packed frames
    )
    from .atomic import (
        Bytes,  # Content of a file in memory
        FileSystem,  # The calls that change a disk, and the durable operations that are made of them
        LocalFileSystem,  # The disk of this machine (POSIX)
        StorageError,  # Error of a failed call to the disk: the text has path, reason and remedy
    )
    from .config import (
        ConfigError,  # Error of a rig file that cannot be used. headline fits a safe screen
        Rig,  # One instrument, as its rig file describes it. Checked when built: see appliance.store.config.checks
        load_rig,  # Read and check a rig file. Raises only ConfigError, for any content of the file
        parse_rig,  # Read a rig from text like load_rig; source names it in messages
    )
    from .config.rig import (
        CameraRig,  # [camera.left] and [camera.right]
        OutputRig,  # [projector], and most of [display]: a connector of a graphics card, or a window on a desk
        ProjectorRig,  # [projector]
    )
    from .damage import (
        SalvagedScan,  # A scan whose lost frames were made up from the others
    )
    from .incomplete import (
        IncompleteRecording,  # An incomplete recording as it lies on disk
    )
    from .instrument import (
        Instrument,  # The instrument of a rig file
        load_calibration,  # Read a calibration file. Raises CalibrationError also for a missing or unreadable file
    )
    from .label import (
        Label,  # Name and note of a scan; None: there is none
    )
    from .library import (
        Library,  # The scans below one storage root. Raises StorageError when a call to the disk fails
        LibraryFolder,  # Folders that a finished scan can lie in; the values are folder names
        PendingScan,  # A scan whose raw frames are durable and that waits for the diver's decision
        ScanEntry,  # One scan in the list. A damaged one is listed like the others, with its problems
        UnknownScan,  # Error of a number that no scan has
    )
    from .lock import (
        hold_lock,  # Hold the lock of root; StorageError if another process has it
        holder,  # Return the process that holds the lock of root, or None
    )
    from .manifest import (
        MANIFEST_FILE,  # Name of that file
        Manifest,  # The whole manifest
        ScanRecord,  # The metadata of a scan: all but its files
        SecondSequence,  # A second sequence of the same scene with another exposure
        SequenceInfo,  # Pattern that each frame shows
    )
    from .names import (
        AIR_FILE,  # Place below a storage root of the calibration in air
        CALIBRATION_FILE,  # Place below a storage root of the calibration in use
        OBJECTS,  # Folder below a storage root with its objects
        by_number,  # Return the sort key of a scan's name: 1000000 comes after 999999
        component,  # Return name, which is one component of a path; ValueError otherwise
        is_kept_calibration,  # Return True if name is the file name of a kept calibration
        is_object,  # Return True if name can name an object, whose folder and files are called so
    )
    from .origin import (
        ChosenCalibration,  # The calibration a scan is reconstructed with
        SourceScan,  # A stored scan and the instrument that took it
    )
    from .picture_size import (
        KNOWN,  # Formats of pictures whose size is read, in words
        picture_head,  # Return width, height and bits that the header states
    )
    from .ply import (
        encode_ply,  # Return the header and body of the file
    )
    from .pull.pulling import (
        pull_scans,  # Copy the finished scans of host that are missing here into the storage root out
    )
    from .reprocess import (
        ReprocessedScan,  # A stored scan after all steps of the instrument's procedure
        reprocess_bracket,  # Reconstruct and judge first and the frames of a second sequence as one
        reprocess_scan,  # Reconstruct and judge a stored scan with calibration, as the instrument does
    )
    from .room import (
        Room,  # A file system whose new files are made of reserved space
    )
    from .root import (
        standing_root,  # Return the storage root around the working directory, else that of KINGFISHER_ROOT
    )
    from .scan import (
        FRAME_FILES,  # Names of all files of frames that a scan may have
        RAW_FILES,  # Names of a scan's files of frames
        RIG_FILE,  # Name of a scan's rig file
        ScanError,  # Error of a stored scan that cannot be used; the text says which and why
        ScanOrigin,  # The means a scan was taken with, as the bytes of the files that describe them
        StoredScan,  # A scan as it lies on disk. frames by side: (n, h, w) uint8, mapped
        size_bytes,  # Return the space that a scan with one exposure needs at most
    )
    from .scan_list import (
        ListedScan,  # One scan of the list, and the artefact that it shows
        ListError,  # Error of a list of scans that cannot be used
        ScanList,  # A list of scans as the metrologist wrote it down
    )
    from .wish import (
        ScanOptions,  # The options that were given beside the scan itself; None: not given
    )
else:
    __getattr__, __dir__, __all__ = lazy_face(__name__)
