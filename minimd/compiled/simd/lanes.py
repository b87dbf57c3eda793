"""How many lanes a vector has, as a type: kernels are compiled for the number that suits processor and precision."""

import functools
import re
from collections import namedtuple

import llvmlite.binding as llvm
from numba.core.registry import cpu_target

from minimd.compiled.kernels import by_type
from minimd.compiled.simd.vector import n_lanes

BITS = 64  # of a number
REGISTERS = {"zmm": 512, "ymm": 256}  # names in assembly of registers with more than 128 bits
PROBE = (
    "define <8 x double> @sum(<8 x double> %a, <8 x double> %b) {\n  %c = fadd <8 x double> %a, %b\n  ret <8 x "
    "double> %c\n}"
)


class Lanes4(namedtuple("Lanes4", "")):
    """Vectors of four numbers."""

    size = 4


class Lanes8(namedtuple("Lanes8", "")):
    """Vectors of eight numbers."""

    size = 8


Lanes = Lanes4 | Lanes8


@by_type
def count(lanes):
    """The number of lanes, of one of Lanes or of a vector, as a constant for the compiler."""
    number = n_lanes(lanes)
    return lambda lanes: number


@functools.cache
def register_bits() -> int:
    """Width of the registers in which Numba's compiler adds vectors, perhaps for another processor than this one."""
    triple, name, features = cpu_target.target_context.codegen().magic_tuple()
    machine = llvm.Target.from_triple(triple).create_target_machine(cpu=name, features=features)
    assembly = machine.emit_assembly(llvm.parse_assembly(PROBE))
    return next((bits for register, bits in REGISTERS.items() if re.search(rf"%{register}\d", assembly)), 128)


@functools.cache
def lanes_for() -> Lanes:
    """Lanes for float64: eight if they fit one register, else four, which take 16 registers in the inner loop."""
    return Lanes8() if register_bits() >= BITS * Lanes8.size else Lanes4()
