"""What compiling the kernels costs."""
