"""The vector type; vectors from numbers and memory, and back; the number of lanes that suits the processor.

Memory is in blocks, where all x of some atoms stand together, then all y, all z; or in rows of tables.
"""

import functools
import re
from collections import namedtuple

import llvmlite.binding as llvm
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.registry import cpu_target
from numba.extending import intrinsic, models, register_model

from minimd.core.compiled.kernels import by_type, in_kernels, scalar

INT32 = ir.IntType(32)
COLUMNS = 8  # of a table of two cubics
LOWEST_BITS = 2**32 - 1
MAGIC = 1.5 * 2.0**52  # plus a small whole number, which is then in the lowest bits


class Vector(types.Type):
    """The Numba type of `lanes` numbers of type `element`: float64, float32, an integer, or boolean for a mask."""

    def __init__(self, element: types.Integer | types.Float | types.Boolean, lanes: int) -> None:
        self.element = element
        self.lanes = lanes
        super().__init__(name=f"Vector({element}, {lanes})")
        self.is_float = isinstance(element, types.Float)

    @property
    def mask(self) -> "Vector":
        """The type of comparisons."""
        return Vector(types.boolean, self.lanes)

    @property
    def suffix(self) -> str:
        """The name of the type in LLVM's functions, v8f64 for instance."""
        return f"v{self.lanes}{'f' if self.is_float else 'i'}{self.element.bitwidth}"  # type: ignore[union-attr]


@register_model(Vector)
class VectorModel(models.PrimitiveModel):
    """A Vector is an LLVM vector; the lanes of a mask are single bits."""

    def __init__(self, manager, fe_type):
        is_mask = fe_type.element == types.boolean
        element = ir.IntType(1) if is_mask else manager.lookup(fe_type.element).get_value_type()
        super().__init__(manager, fe_type, ir.VectorType(element, fe_type.lanes))


def emitting(emit):
    """The code generator of an intrinsic that emits what emit(builder, *values) does."""
    return lambda context, builder, signature, arguments: emit(builder, *arguments)


@intrinsic
def broadcast(_context, number, like):
    """A number in all lanes, as a vector of the type of like; a vector of that type is returned as it is."""
    if isinstance(number, Vector) and number != like:
        return None

    def generate(context, builder, signature, arguments):
        if isinstance(number, Vector):
            return arguments[0]
        value = context.cast(builder, arguments[0], number, like.element)
        empty = ir.Constant(ir.VectorType(value.type, like.lanes), ir.Undefined)
        first = builder.insert_element(empty, value, INT32(0))
        return _some_lanes(builder, first, [0] * like.lanes)

    return like(number, like), generate


@intrinsic
def zeros(_context, lanes):
    """Zeros in all lanes, float64.
    lanes : one of simd.lanes."""
    kind = Vector(types.float64, n_lanes(lanes))
    return kind(lanes), lambda context, builder, _, values: context.get_value_type(kind)(None)


@intrinsic
def bits_from_mask(_context, mask):
    """A mask as an int64 whose bit k is lane k; zero if no lane is set."""

    def emit(builder, value):
        return builder.zext(builder.bitcast(value, ir.IntType(mask.lanes)), ir.IntType(64))

    return types.int64(mask), emitting(emit)


@intrinsic
def trailing_zeros(_context, bits):
    """The number of the lowest bit of an uint64 that is set; 64 if none is."""
    zero_is_defined = ir.Constant(ir.IntType(1), 0)
    emit = emitting(lambda builder, value: builder.cttz(value, zero_is_defined))
    return types.uint64(types.uint64), emit


@intrinsic
def as_floats(_context, whole):
    """A vector of int64 as one of float64."""
    kind = Vector(types.float64, whole.lanes)
    return kind(whole), lambda context, builder, _, values: builder.sitofp(
        values[0], context.get_value_type(kind)
    )


def _with_bits_of(other: types.Number):
    """An intrinsic for the number, or the vector, of another type of 64 bits that has the same bits."""

    @intrinsic
    def one(_context, x):
        kind = Vector(other, x.lanes) if isinstance(x, Vector) else other
        return kind(x), lambda context, builder, _, values: builder.bitcast(
            values[0], context.get_value_type(kind)
        )

    return one


bits_of = _with_bits_of(types.int64)
float_of = _with_bits_of(types.float64)


@intrinsic
def total(_context, vector):
    """The sum of all lanes: the upper half is added to the lower one until one number is left."""

    def generate(context, builder, signature, arguments):
        value = arguments[0]
        lanes = vector.lanes
        while lanes > 1:
            lanes //= 2
            lower = _some_lanes(builder, value, range(lanes))
            upper = _some_lanes(builder, value, range(lanes, 2 * lanes))
            value = (builder.fadd if vector.is_float else builder.add)(lower, upper)
        return builder.extract_element(value, INT32(0))

    return vector.element(vector), generate


@intrinsic
def lane(_context, vector, k):
    """The number in lane k."""
    emit = emitting(lambda builder, *values: builder.extract_element(*values))
    return vector.element(vector, k), emit


@intrinsic
def with_lane(_context, vector, k, number):
    """The vector with another number in lane k."""

    def generate(context, builder, signature, arguments):
        value = context.cast(builder, arguments[2], number, vector.element)
        return builder.insert_element(arguments[0], value, arguments[1])

    return vector(vector, k, number), generate


@intrinsic(prefer_literal=True)
def load(_context, array, index, lanes):
    """Contiguous elements of a one-dimensional array, from index.
    lanes : literal, one of simd.lanes, or a vector."""
    kind = Vector(array.dtype, n_lanes(lanes))

    def generate(context, builder, signature, arguments):
        value = builder.load(_pointer_to(context, builder, array, arguments, kind))
        value.align = array.dtype.bitwidth // 8
        return value

    return kind(array, types.intp, lanes), generate


@intrinsic
def store(_context, array, index, vector):
    """Write a vector to contiguous elements of a one-dimensional array, from index."""

    def generate(context, builder, signature, arguments):
        pointer = _pointer_to(context, builder, array, arguments, vector)
        written = builder.store(arguments[2], pointer)
        written.align = array.dtype.bitwidth // 8
        return context.get_dummy_value()

    return types.void(array, types.intp, vector), generate


def n_lanes(lanes: types.Type) -> int:
    """The number of lanes that a Numba type stands for: a vector, one of simd.lanes, or a literal."""
    if isinstance(lanes, Vector):
        return lanes.lanes
    if isinstance(lanes, types.Literal):
        return lanes.literal_value  # type: ignore[attr-defined]
    return lanes.instance_class.size  # type: ignore[attr-defined]


def _some_lanes(builder, value, numbers):
    """Some lanes of a vector, as a shorter or longer one."""
    pattern = ir.Constant(ir.VectorType(INT32, len(numbers)), list(numbers))
    return builder.shuffle_vector(value, ir.Constant(value.type, ir.Undefined), pattern)


def call(builder, name, result, arguments):
    """Call one of LLVM's functions by name."""
    kind = ir.FunctionType(result, [argument.type for argument in arguments])
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, name), arguments)


def _pointer_to(context, builder, kind, arguments, vector):
    """The address of an element, as that of a vector.
    arguments : an array of type kind, and an index, as values."""
    data = context.make_array(kind)(context, builder, arguments[0]).data
    element = builder.gep(data, [arguments[1]])
    return builder.bitcast(element, context.get_value_type(vector).as_pointer())


@scalar
def loaded(blocks, start, lanes):
    """The vectors x, y, z of a block, from index start on."""
    n = np.uintp(count(lanes))
    x = load(blocks, start, lanes)
    y = load(blocks, start + n, lanes)
    z = load(blocks, start + n + n, lanes)
    return x, y, z


@scalar
def stored(blocks, start, xyz):
    """Write the vectors x, y, z of a block."""
    x, y, z = xyz
    n = np.uintp(count(xyz[0]))
    store(blocks, start, x)
    store(blocks, start + n, y)
    store(blocks, start + n + n, z)


@scalar
def gathered(table, numbers, start, lanes):
    """The vectors x, y, z of the rows numbers[start], numbers[start + 1], … of a table (N, 3)."""
    x = y = z = zeros(lanes)
    for k in range(count(lanes)):
        i = np.uintp(numbers[start + k])
        x = with_lane(x, k, table[i, 0])
        y = with_lane(y, k, table[i, 1])
        z = with_lane(z, k, table[i, 2])
    return x, y, z


@intrinsic
def _columns_of_rows(_context, table, places):
    """See columns_at: two numbers at a time of each of the rows, one for each lane, are loaded and transposed."""
    lanes = places.lanes
    kind = Vector(types.float64, lanes)

    def generate(context, builder, signature, arguments):
        data = context.make_array(table)(context, builder, arguments[0]).data
        whole = ir.VectorType(ir.IntType(64), lanes)
        in_all = lambda number: ir.Constant(whole, [number] * lanes)  # noqa: E731
        rows = builder.and_(builder.bitcast(arguments[1], whole), in_all(LOWEST_BITS))
        first = builder.mul(rows, in_all(COLUMNS))
        starts = [
            builder.gep(data, [builder.extract_element(first, INT32(k))]) for k in range(lanes)
        ]
        columns = []
        for c in range(0, COLUMNS, 2):
            pairs = [_two_numbers(builder, start, c) for start in starts]
            columns += _transposed(builder, pairs)
        return context.make_tuple(builder, signature.return_type, columns)

    return types.UniTuple(kind, COLUMNS)(table, places), generate


def _two_numbers(builder, start, c):
    """Elements c and c + 1 behind an address."""
    two = ir.VectorType(ir.DoubleType(), 2).as_pointer()
    value = builder.load(builder.bitcast(builder.gep(start, [ir.IntType(64)(c)]), two))
    value.align = 8
    return value


def _transposed(builder, pairs):
    """The first numbers of pairs, and the second ones. Pairs with an even number are joined, those with an odd number,
    and then both are interleaved: registers of four numbers exchange none between their halves."""
    even, odd = (_joined(builder, pairs[start::2]) for start in (0, 1))
    n = len(pairs)
    for first in (0, 1):
        pattern = [k - k % 2 + first + n * (k % 2) for k in range(n)]
        yield builder.shuffle_vector(even, odd, ir.Constant(ir.VectorType(INT32, n), pattern))


def _joined(builder, parts):
    """Vectors one after the other as one."""
    while len(parts) > 1:
        every = [*range(2 * parts[0].type.count)]
        pattern = ir.Constant(ir.VectorType(INT32, len(every)), every)
        couples = zip(parts[::2], parts[1::2], strict=True)
        parts = [builder.shuffle_vector(first, second, pattern) for first, second in couples]
    return parts[0]


def columns_at(table, places):
    """The eight columns of a row of a table, or of one row for each lane: numbers or vectors.

    table : (R, 8) float64, contiguous.
    places : MAGIC plus the number of a row, which is not checked.
    """
    return tuple(table[int(places - MAGIC)].tolist())


@in_kernels(columns_at)
def _columns_at(table, places):
    if isinstance(places, Vector):
        return lambda table, places: _columns_of_rows(table, places)

    def of_row(table, places):
        row = table[np.uintp(places - MAGIC)]
        return row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7]

    return of_row


@by_type
def loaded_columns(columns, start, lanes):
    """A vector of each of a tuple of columns, from index start on; unrolled by the compiler."""
    if len(columns) == 0:
        return lambda columns, start, lanes: ()
    return lambda columns, start, lanes: (
        (load(columns[0], start, lanes),) + loaded_columns(columns[1:], start, lanes)
    )


BITS = 64  # of a number
REGISTERS = {"zmm": 512, "ymm": 256}  # names in assembly of registers with more than 128 bits
PROBE = (
    "define <8 x double> @sum(<8 x double> %a, <8 x double> %b) "
    "{\n  %c = fadd <8 x double> %a, %b\n  ret <8 x double> %c\n}"
)


class Lanes4(namedtuple("Lanes4", "")):
    """Vectors of four numbers."""

    size = 4


class Lanes8(namedtuple("Lanes8", "")):
    """Vectors of eight numbers."""

    size = 8


class Lanes16(namedtuple("Lanes16", "")):
    """Vectors of sixteen numbers: of several registers."""

    size = 16


Lanes = Lanes4 | Lanes8 | Lanes16


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
    for register, bits in REGISTERS.items():
        if re.search(rf"%{register}\d", assembly):
            return bits
    return 128


@functools.cache
def lanes_for() -> Lanes:
    """Lanes for float64: eight if they fit one register, else four, which take 16 registers in the inner loop."""
    return Lanes8() if register_bits() >= BITS * Lanes8.size else Lanes4()
