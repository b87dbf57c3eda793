"""Vectors from and to contiguous memory."""

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from minimd.compiled.simd.vector import Vector, call


@intrinsic(prefer_literal=True)
def load(_context, array, index, lanes):
    """`lanes` (a literal) contiguous elements of a one-dimensional array, from index."""
    kind = Vector(array.dtype, lanes.literal_value)

    def generate(context, builder, signature, arguments):
        pointer = pointer_to(context, builder, array, arguments[0], arguments[1], kind)
        value = builder.load(pointer)
        value.align = array.dtype.bitwidth // 8
        return value

    return kind(array, types.intp, lanes), generate


@intrinsic
def store(_context, array, index, vector):
    """Write a vector to contiguous elements of a one-dimensional array, from index."""

    def generate(context, builder, signature, arguments):
        pointer = pointer_to(context, builder, array, arguments[0], arguments[1], vector)
        builder.store(arguments[2], pointer).align = array.dtype.bitwidth // 8
        return context.get_dummy_value()

    return types.void(array, types.intp, vector), generate


@intrinsic
def store_compressed(_context, array, index, vector, mask):
    """Write the lanes where the mask is set, one after the other, from index; as many elements are written as bits are set."""

    def generate(context, builder, signature, arguments):
        pointer = pointer_to(context, builder, array, arguments[0], arguments[1], vector)
        element = builder.bitcast(pointer, context.get_value_type(array.dtype).as_pointer())
        call(builder, f"llvm.masked.compressstore.{vector.suffix}", ir.VoidType(), (arguments[2], element, arguments[3]))
        return context.get_dummy_value()

    return types.void(array, types.intp, vector, mask), generate


def pointer_to(context, builder, kind, array, index, vector):
    """The address of an element of an array, as that of a vector."""
    data = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), context.get_value_type(vector).as_pointer())
