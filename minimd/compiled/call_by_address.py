"""Calls of a kernel, by its address, from another one that does not contain it: it is compiled only once."""

from numba import types
from numba.core import cgutils
from numba.extending import intrinsic


def _call(returned: types.Type):
    """An intrinsic (address, arguments): calls a kernel that returns this. The arguments, a tuple, must be of the types
    that DirectCalls.address was given; for a ByAddress its address will do."""

    @intrinsic
    def call(_context, address, arguments):
        def generate(context, builder, signature, values):
            kinds, convention = signature.args[1].types, context.call_conv
            code = builder.inttoptr(values[0], convention.get_function_type(returned, kinds).as_pointer())
            each = cgutils.unpack_tuple(builder, values[1], len(kinds))
            status, result = convention.call_function(builder, code, returned, kinds, each)
            with cgutils.if_unlikely(builder, status.is_error):
                convention.return_status_propagate(builder, status)
            return result

        return returned(types.intp, arguments), generate

    return call


# of a kernel that returns a whole number, and of one that returns nothing
call_at, run_at = _call(types.int64), _call(types.none)
