"""Vectors from and to contiguous memory."""

from numba import types
from numba.extending import intrinsic

from minimd.compiled.simd.vector import Vector


@intrinsic(prefer_literal=True)
def load(_context, array, index, lanes):
    """`lanes` (a literal) contiguous elements of a one-dimensional array, from index."""
    kind = Vector(array.dtype, lanes.literal_value)

    def generate(context, builder, signature, arguments):
        value = builder.load(pointer_to(context, builder, array, arguments, kind))
        value.align = array.dtype.bitwidth // 8
        return value

    return kind(array, types.intp, lanes), generate


@intrinsic
def store(_context, array, index, vector):
    """Write a vector to contiguous elements of a one-dimensional array, from index."""

    def generate(context, builder, signature, arguments):
        pointer = pointer_to(context, builder, array, arguments, vector)
        builder.store(arguments[2], pointer).align = array.dtype.bitwidth // 8
        return context.get_dummy_value()

    return types.void(array, types.intp, vector), generate


def pointer_to(context, builder, kind, arguments, vector):
    """The address of an element of an array, as that of a vector.  arguments : values of the array, of type kind, and of the index."""
    data = context.make_array(kind)(context, builder, arguments[0]).data
    return builder.bitcast(builder.gep(data, [arguments[1]]), context.get_value_type(vector).as_pointer())
