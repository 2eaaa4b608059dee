"""Base of all packages: kernels, start of a process, sealed files, pages, and optional libraries."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .face import lazy_face

if TYPE_CHECKING:
    from .argument_types import (
        refuse_wrong_fields,  # Return a dataclass whose constructor checks its arguments against the fields'
        refuse_wrong_types,  # Return function with its arguments checked against its annotations at every call
    )
    from .bounded_file import (
        parse_toml,  # Return the tables of a TOML 1.0 text
        read_bounded,  # Return the bytes of a regular file. Raises OSError for any other kind
        read_text,  # Return the text of a regular file in UTF-8, without a byte-order mark at its beginning
        refuse_irregular,  # Raise OSError unless path is a regular file of at most most_bytes
    )
    from .distribution import (
        other_program,  # Return one sentence about an installed distribution that shadows ours; None: there is none
    )
    from .face import (
        modules_of_face,  # Return the module of each name in the face of a package
    )
    from .kernel_build import (
        CompileError,  # Some kernels could not be compiled; the text names them, each with its reason
        Compiling,  # Progress of compiling: done pieces of total
        Piece,  # Some kernels that are compiled together
        build_kernels,  # Compile pieces into a new folder of target, atomically; return that folder
        compile_pieces,  # Compile those of pieces that folder lacks, in their order
        missing_kernels,  # Return those of the pieces that are still to be compiled into folder
    )
    from .kernel_cache import (
        COMMON_KERNELS,  # Every x86 since 2013 to 2015; its features follow from the name
        KernelCache,  # The folder that numba uses from now on
        KernelOrigin,  # The source of the kernels in use
        shipped_kernels,  # Return the folder of an installation's kernels
        use_kernel_cache,  # Point numba at kernels of exactly this program, before any of their modules is imported
    )
    from .libraries import (
        MissingLibraryError,  # A library of the desk is not installed
        needed,  # Import module of package, which what (a file or a page, in words) needs
        require,  # Raise MissingLibraryError if package is absent; imports nothing
    )
    from .page import (
        Html,  # A text that is HTML already, for a cell of a table
        Page,  # A page in the making, from its head on: one file of HTML with its pictures in it
    )
    from .plot import (
        ColourScale,  # Colours 0..255 from the lowest value to the highest, equally spaced
        bars,  # Draw a bar for each name, full for a share of 1, as a complete svg element
        draw_curves,  # Draw curves (x, y) by name into axes that hold all of them; return a PNG
        histogram,  # Draw a histogram of values (n,) between low and high, as a complete svg element
        minus,  # Return a number in digits with a minus sign as long as a plus
        number_text,  # Return a number as an axis has it
        png,  # Return an image (h, w) grey or (h, w, 3) BGR as PNG. Raises ValueError if it cannot be encoded
    )
    from .process_start import (
        importing,  # Import modules inside without garbage collection, and freeze the objects that they make
        interrupts,  # Return True if error is an interruption (Ctrl-C), or was made of one
        raise_if_interrupted,  # Raise KeyboardInterrupt if error was made of one
        use_one_blas_thread,  # Let linear algebra take one thread in processes of this environment
    )
    from .progress import (
        Progress,  # Callback for the current activity, in words, and the finished share of the work (0..1), if known
        part_of,  # Return the progress of a part of the work, which is the fractions begin to end of it
        silent,  # Report no progress
    )
    from .sealed_file import (
        FINITE,  # Range of every finite number
        LEFT_OUT,  # Metadata of a field that is not written while it has its default
        Among,  # The only values that are accepted
        ContentError,  # Reason why a file cannot be used
        SealedFile,  # One kind of file, whose content is the frozen dataclass kind
        Within,  # Range of a number, both ends included. Booleans are not numbers here
        digest,  # Return SHA-256 (hex) of the compact form with sorted keys
        plain,  # Convert a value to JSON's types: plain numbers, None for numbers that are not finite
        shaped,  # Return the dataclass kind with the fields of a JSON object
    )
    from .text import (
        one_line,  # Return a dataclass in one line, for __repr__: Mesh(vertices_mm=(8100, 3) float32, …)
    )
else:
    __getattr__, __dir__, __all__ = lazy_face(__name__)
