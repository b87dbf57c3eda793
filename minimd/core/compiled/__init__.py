"""How Numba is used: decorators of kernels and their cache, vectors, threads, the machine."""
