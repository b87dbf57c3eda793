"""Calls of a kernel, by its address, from another one that does not contain it: it is compiled only once."""

from numba import types
from numba.core import cgutils
from numba.extending import intrinsic


@intrinsic
def call_at(_context, address, arguments):
    """The whole number that a kernel returns. Its arguments, a tuple, must be of the very types that DirectCalls.address was given."""

    def generate(context, builder, signature, values):
        kinds, convention = signature.args[1].types, context.call_conv
        code = builder.inttoptr(values[0], convention.get_function_type(types.int64, kinds).as_pointer())
        each = cgutils.unpack_tuple(builder, values[1], len(kinds))
        status, number = convention.call_function(builder, code, types.int64, kinds, each)
        with cgutils.if_unlikely(builder, status.is_error):
            convention.return_status_propagate(builder, status)
        return number

    return types.int64(types.intp, arguments), generate
