"""Vectors for Numba: one variable holds several numbers, and `a + b` adds them all in one machine instruction.

    x = load(positions, start, 8)            # eight contiguous elements of a one-dimensional array, from index start
    r2 = x * x + 1.0                         # operators act lane by lane; a number is copied to all lanes
    near = r2 < cutoff2                      # comparisons give a mask, one bit for each lane
    f = select(near, 1.0 / r2, 0.0)          # lane by lane: where near the first, elsewhere the second
    store(forces, start, f)
    total(f)                                 # the sum of the lanes, always in the same order

To Numba such a variable has the type Vector(element, lanes); its value is a vector of LLVM, the compiler beneath Numba.
LLVM knows `fadd <8 x double>` as it knows `fadd double`, and translates it to the widest instructions of the processor
at hand: one for AVX-512, two for AVX2, four for NEON. So a law for numbers compiles for vectors from the same source.

How to add an operation. If LLVM has an instruction or a function for it, make an intrinsic with `_instruction` or
`_function`, see arithmetic.py, or write an `@intrinsic`: it gets the Numba types of its arguments, and returns the
signature `result(arguments)` and a function that emits instructions with llvmlite's IRBuilder. Bind it to the Python
name that laws use with `_bind` or `@in_kernels`. Without an instruction, apply a function lane by lane: see `bind_one`.
"""

import minimd.core.compiled.simd.functions  # noqa: F401 - lets those of math and numpy act on vectors
from minimd.core.compiled.simd.arithmetic import fma, select
from minimd.core.compiled.simd.vector import (
    as_floats,
    bits_from_mask,
    broadcast,
    lane,
    load,
    store,
    total,
    trailing_zeros,
    with_lane,
    zeros,
)

__all__ = ["as_floats", "bits_from_mask", "broadcast", "fma", "lane", "load"]
__all__ += ["select", "store", "total", "trailing_zeros", "with_lane", "zeros"]
