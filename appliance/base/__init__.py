"""Ground of all rooms: compiled kernels and their place, how a process starts, sealed files, libraries that may be
missing."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .face import lazy_face

if TYPE_CHECKING:
    from .argument_types import (
        refuse_wrong_fields,  # Return a dataclass whose constructor compares its arguments with the annotations
        refuse_wrong_types,  # Return function with its arguments compared with its annotations at every call
    )
    from .bounded_file import (
        parse_toml,  # Return what TOML 1.0 holds. Raises ValueError
        read_bounded,  # Return the bytes of a regular file. Raises OSError for any other kind
        read_text,  # Return the text of a regular file in UTF-8
        refuse_irregular,  # Raise OSError for anything but a regular file, and for one of more than most_bytes
    )
    from .distribution import (
        other_program,  # Return one sentence about another distribution that has our command and import name
    )
    from .face import (
        modules_of_face,  # Return the module of each name in the face of a package
    )
    from .kernel_build import (
        CompileError,  # Some kernels could not be compiled; the text says which and why
        Compiling,  # Progress of compiling: done pieces of of
        Piece,  # Some kernels that are compiled together
        build_kernels,  # Compile pieces into a folder of target, which is there whole or not at all
        compile_pieces,  # Compile what folder has not of pieces, the first ones first, for processor (default
        missing_kernels,  # Return those of the pieces that are still to be compiled into folder
    )
    from .kernel_cache import (
        COMMON_KERNELS,  # Every x86 since 2013 to 2015; its features follow from the name
        KernelCache,  # The folder that numba uses from now on
        KernelOrigin,  # The source of the kernels in use
        shipped_kernels,  # Return the folder of what an installation compiled
        use_kernel_cache,  # Point numba at kernels of exactly this program, before any of their modules is imported
    )
    from .libraries import (
        MissingLibraryError,  # A library of the desk is not installed
        needed,  # Import module of package, which what (a file or a page, in words) cannot do without
        require,  # Raises MissingLibraryError where package is absent, before minutes of work; nothing is imported
    )
    from .page import (
        Html,  # A text that is HTML already, for a cell of a table
        Page,  # A page in the making, from its head on: one file of HTML with its pictures in it
    )
    from .plot import (
        ColourScale,  # Colours from the lowest value to the highest: sequential, diverging, greys
        bars,  # Draw a bar for each name, full for a share of 1
        draw_curves,  # Draw curves by name into axes that hold all of them; a PNG
        histogram,  # Draw how many values lie where between two ends
        minus,  # Return a number in digits with a minus sign as long as a plus
        number_text,  # Return a number as an axis has it
        png,  # Return an image as PNG
    )
    from .process_start import (
        importing,  # Import modules inside without the garbage collector, and keep it from what they made ever after
        interrupts,  # Return True if error is an interruption (Ctrl-C), or was made of one
        raise_if_interrupted,  # Raises KeyboardInterrupt where error was made of one
        use_one_blas_thread,  # Let linear algebra take one thread in processes of this environment
    )
    from .progress import (
        Progress,  # Hears what is being done now, and how much of the whole is done
        part_of,  # Return the progress of a part of the work, which is the fractions begin to end of the whole
        silent,  # Say nothing: the progress that nobody waits for
    )
    from .sealed_file import (
        FINITE,  # Range of every finite number
        LEFT_OUT,  # Metadata of a field that is not written while it has its default
        Among,  # The only values that are taken
        ContentError,  # Reason why a file cannot be used. what: the file
        SealedFile,  # One kind of file, whose content is the frozen dataclass kind
        Within,  # Range of a number, both ends included. A truth value is none
        digest,  # Return SHA-256 (hex) of the compact form with sorted keys
        plain,  # Convert a value to what JSON holds
        shaped,  # Return a dataclass with the fields of a JSON object; ContentError for the first wrong one
    )
    from .text import (
        one_line,  # Return a dataclass in one line, for __repr__: Mesh(vertices_mm=(8100, 3) float32, …)
    )
else:
    __getattr__, __dir__, __all__ = lazy_face(__name__)
