"""Every test process finds the compiled kernels of this tree, also without ``./dev``, and begins as the instrument's do."""

from __future__ import annotations

import os

from appliance import kernel_cache
from appliance.process_start import use_one_blas_thread

kernel_cache.use()
use_one_blas_thread(os.environ)  # before anything imports NumPy
