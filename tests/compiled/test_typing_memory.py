import operator

import numba
import numpy as np
import pytest
from numba import types
from numba.core.compiler import Flags
from numba.core.registry import cpu_target
from numba.extending import models, overload, register_model

from minimd.core.compiled import typing_memory
from minimd.core.compiled.kernels import kernel, scalar

KINDS = [types.int64, types.uint64, types.float64, types.float32, types.boolean, types.literal(3)]
FUNCTIONS = [operator.add, operator.truediv, operator.lt, operator.pow, max, abs]


@pytest.mark.parametrize("function", FUNCTIONS, ids=lambda function: function.__name__)
def test_a_remembered_type_is_the_one_that_numba_finds(function):
    context = cpu_target.typing_context
    context.refresh()
    of_function = context.resolve_value_type(function)
    n = 1 if function is abs else 2
    kinds = [kind for kind in KINDS if function is not max or kind is not types.boolean]  # not in all versions of Numba
    for arguments in [(a, b)[:n] for a in kinds for b in kinds]:
        find = typing_memory._find_type
        found = [find(of_function, context, arguments, {}), *(of_function.get_call_type(context, arguments, {}),) * 2]
        assert len({(signature.return_type, signature.args) for signature in found}) == 1


def test_an_operation_that_is_defined_later_is_found():
    class MoneyType(types.Type):
        pass

    register_model(MoneyType)(models.OpaqueModel)
    kind = MoneyType("Money")
    context = cpu_target.typing_context
    with pytest.raises(numba.TypingError):
        context.resolve_value_type(operator.add).get_call_type(context, (kind, kind), {})

    @overload(operator.add)
    def add_money(a, b):
        return (lambda a, b: 7) if a is kind and b is kind else None

    context.refresh()
    signature = context.resolve_value_type(operator.add).get_call_type(context, (kind, kind), {})
    assert isinstance(signature.return_type, types.Integer)


def test_flags_are_equal_if_all_options_have_the_same_values():
    one, other = Flags(), Flags()
    assert one == other
    other.nrt = one.nrt  # set to its default
    assert one == other
    assert hash(one) == hash(other)
    other.nrt = not one.nrt
    assert one != other
    assert one != "flags"


def test_a_part_is_compiled_once_for_all_constants():
    @scalar
    def shifted(x, by):
        return x + by

    @kernel
    def total(x):
        return shifted(x, 1) + shifted(x, 2) + shifted(x, np.int64(x))

    assert total(4) == 19
    assert len(shifted.overloads) == 1
