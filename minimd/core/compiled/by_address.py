"""Named tuples that kernels get by one address, not array by array with all sizes: they compile in half the time.

A kernel can call another one by its address, too, and does not contain it: that one is compiled only once.
"""

import functools
from hashlib import sha256
from itertools import accumulate
from struct import pack, unpack
from typing import Any

import numpy as np
from llvmlite import ir
from numba import extending, types
from numba.core import cgutils
from numba.extending import NativeValue, intrinsic, models, typeof_impl
from numba.np.numpy_support import as_dtype

WORD = 8  # bytes of a number, an address or a size


class ByAddress:
    """Base of a named tuple, to be named before it: class Rows(ByAddress, namedtuple("Rows", "start stops")).
    Its fields are arrays, float, int, tuples of these, and other such named tuples. Kernels read them as those of any
    named tuple, but do not make one. They take for granted that no field changes; the elements of arrays may."""

    @functools.cached_property
    def words(self) -> np.ndarray[Any, np.dtype[np.int64]]:
        """What kernels read, field by field: address, shape and strides of an array; a number; a ByAddress' address."""
        return np.array(_words_of(tuple(self)), dtype=np.int64)  # type: ignore[arg-type, call-overload]

    @functools.cached_property
    def address(self) -> int:
        """Where the words are. They are there as long as this object is."""
        return _address_of(self.words)

    def __getstate__(self) -> None:
        """Copies, and what is read from a pickle, have words of their own."""


def _words_of(value: Any) -> list[int]:
    if isinstance(value, np.ndarray):
        return [_address_of(value), *value.shape, *value.strides]
    if isinstance(value, ByAddress):
        return [value.address]
    if isinstance(value, tuple):
        return [word for part in value for word in _words_of(part)]
    return list(unpack("q", pack("d", value))) if isinstance(value, float) else [int(value)]


def _address_of(array: np.ndarray) -> int:
    return array.__array_interface__["data"][0]


class AddressType(types.NamedTuple):
    """The Numba type of a ByAddress; its name is short, since it is part of many others."""

    def __init__(self, kinds: tuple[types.Type, ...], cls: type) -> None:
        super().__init__(kinds, cls)
        self.name = f"{cls.__name__}_{sha256(self.name.encode()).hexdigest()[:16]}"
        self.places = list(accumulate(map(_n_words, self.types), initial=0))


def _n_words(kind: Any) -> int:
    """How many words a field of this type has."""
    if isinstance(kind, types.Array):
        return 1 + 2 * kind.ndim
    return sum(map(_n_words, kind.types)) if _is_word_by_word(kind) else 1


def _is_word_by_word(kind: Any) -> bool:
    """Whether a type is that of a tuple, whose words stand one after the other."""
    return isinstance(kind, types.BaseTuple) and not isinstance(kind, AddressType)


@typeof_impl.register(ByAddress)
def _typeof(value, context):
    if "kind" not in vars(value):  # found once for each object: many share parts
        kinds = tuple(typeof_impl(part, context) for part in value)
        vars(value)["kind"] = AddressType(kinds, type(value))
    return vars(value)["kind"]


@extending.register_model(AddressType)
class AddressModel(models.PrimitiveModel):
    """An address is a number."""

    def __init__(self, manager, fe_type):
        super().__init__(manager, fe_type, ir.IntType(8 * WORD))


@extending.unbox(AddressType)
def _unboxed(_kind, value, c):
    number = c.pyapi.object_getattr_string(value, "address")
    address = c.pyapi.long_as_longlong(number)
    c.pyapi.decref(number)
    return NativeValue(address, is_error=cgutils.is_not_null(c.builder, c.pyapi.err_occurred()))


@extending.lower_getattr_generic(AddressType)
def _field(context, builder, kind, address, name):
    k = kind.fields.index(name)
    return _value_at(context, builder, kind[k], address, kind.places[k])


@extending.lower_builtin("static_getitem", AddressType, types.IntegerLiteral)
def _item(context, builder, signature, arguments):
    kind, _ = signature.args
    address, index = arguments
    k = index % len(kind)
    return _value_at(context, builder, kind[k], address, kind.places[k])


def _value_at(context, builder, kind, address, place):
    """The value of a type whose words begin at a place after an address."""
    if isinstance(kind, types.Array):
        return _array(context, builder, kind, address, place)
    if _is_word_by_word(kind):
        parts = []
        for part in kind:
            parts.append(_value_at(context, builder, part, address, place))
            place += _n_words(part)
        return context.make_tuple(builder, kind, parts)
    return _word(builder, context.get_value_type(kind), address, place)


def _array(context, builder, kind, address, place):
    """An array that owns nothing."""
    model = context.data_model_manager[kind]
    word = ir.IntType(8 * WORD)
    element = context.get_data_type(kind.dtype)
    itemsize = word(as_dtype(kind.dtype).itemsize)
    n = kind.ndim
    sizes = [_word(builder, word, address, place + 1 + k) for k in range(2 * n)]
    shape = sizes[:n]
    strides = sizes[n:]
    if n == 1 and kind.layout == "C":
        strides = [itemsize]
    parts = {
        "nitems": functools.reduce(builder.mul, shape),
        "itemsize": itemsize,
        "data": _word(builder, element.as_pointer(), address, place),
        "shape": cgutils.pack_array(builder, shape, word),
        "strides": cgutils.pack_array(builder, strides, word),
    }
    array = ir.Constant(model.get_value_type(), None)  # no owner
    for name, part in parts.items():
        array = model.set(builder, array, part, name)
    return array


def _word(builder, kind, address, place):
    """It never changes, so that the compiler may read it once, before a loop."""
    at = builder.add(address, address.type(WORD * place))
    read = builder.load(builder.inttoptr(at, kind.as_pointer()))
    read.set_metadata("invariant.load", builder.module.add_metadata([]))
    return read


def _call(returned: types.Type):
    """An intrinsic (address, arguments): calls a kernel that returns this. The arguments, a tuple, must be of the types
    that DirectCalls.address was given; for a ByAddress its address will do."""

    @intrinsic
    def call(_context, address, arguments):
        def generate(context, builder, signature, values):
            kinds = signature.args[1].types
            convention = context.call_conv
            pointer = convention.get_function_type(returned, kinds).as_pointer()
            code = builder.inttoptr(values[0], pointer)
            parts = cgutils.unpack_tuple(builder, values[1], len(kinds))
            status, result = convention.call_function(builder, code, returned, kinds, parts)
            with cgutils.if_unlikely(builder, status.is_error):
                convention.return_status_propagate(builder, status)
            return result

        return returned(types.intp, arguments), generate

    return call


# of a kernel that returns a whole number, and of one that returns nothing
call_at = _call(types.int64)
run_at = _call(types.none)
