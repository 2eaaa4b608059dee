"""Cost of compiling the kernels."""
