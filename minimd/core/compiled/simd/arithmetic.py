"""What laws need of vectors: operators, comparisons, choices, functions."""

import math
import operator

import numpy as np
from numba import types
from numba.extending import intrinsic

from minimd.core.compiled.kernels import in_kernels, scalar
from minimd.core.compiled.machine import rounds_once
from minimd.core.compiled.simd.vector import (
    Vector,
    broadcast,
    call,
    count,
    emitting,
    lane,
    with_lane,
)

# methods of IRBuilder; those for integers have the names of the operators
FLOAT_OPERATORS = {
    operator.add: "fadd",
    operator.sub: "fsub",
    operator.mul: "fmul",
    operator.truediv: "fdiv",
}
INTEGER_OPERATORS = {getattr(operator, name): name for name in ("add", "sub", "mul", "and_", "or_")}
INTEGER_OPERATORS |= {operator.lshift: "shl", operator.rshift: "ashr"}
# by names in operator
COMPARISONS = {"lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==", "ne": "!="}
LANE_BY_LANE = math.tanh, math.erf, math.erfc, np.tanh


def _instruction(of_floats: str, of_integers: str, *sign: str):
    """An intrinsic for two vectors of one type: IRBuilder's methods for floats and integers, a comparison's sign."""

    @intrinsic
    def operation(_context, a, b):
        method = of_floats if a.is_float else of_integers
        result = a.mask if sign else a
        emit = emitting(lambda builder, *pair: getattr(builder, method)(*sign, *pair))
        return result(a, b), emit

    return operation


def _function(name: str):
    """An intrinsic for one of LLVM's functions whose argument and result are of one vector type."""

    @intrinsic
    def operation(_context, a):
        function = f"llvm.{name}.{a.suffix}"
        return a(a), emitting(lambda builder, x: call(builder, function, x.type, [x]))

    return operation


_square_root = _function("sqrt")
_magnitude = _function("fabs")
_floor = _function("floor")


@intrinsic
def _multiply_add(_context, a, b, c):
    suffix = a.suffix if isinstance(a, Vector) else f"f{a.bitwidth}"
    function = f"llvm.{'fma' if rounds_once() else 'fmuladd'}.{suffix}"
    return a(a, b, c), emitting(lambda builder, *abc: call(builder, function, abc[0].type, abc))


def fma(a, b, c):
    """a · b + c of numbers, or of vectors (b and c may be numbers), rounded once in kernels, see rounds_once."""
    return a * b + c


@in_kernels(fma)
def _fma(a, b, c):
    if isinstance(a, Vector):
        return lambda a, b, c: _multiply_add(a, broadcast(b, a), broadcast(c, a))
    return lambda a, b, c: _multiply_add(a, b, c)


@intrinsic
def _choose(_context, mask, a, b):
    return a(mask, a, b), emitting(lambda builder, *values: builder.select(*values))


def select(mask, a, b):
    """Lane by lane: a where the mask is set, b elsewhere; one of them may be a number. a if mask else b for a bool."""
    return np.where(mask, a, b)


@in_kernels(select)
def _select(mask, a, b):
    if isinstance(mask, Vector):
        if isinstance(a, Vector):
            return lambda mask, a, b: _choose(mask, a, broadcast(b, a))
        return lambda mask, a, b: _choose(mask, broadcast(a, b), b)
    if isinstance(a, Vector):
        return lambda mask, a, b: a if mask else broadcast(b, a)
    if isinstance(b, Vector):
        return lambda mask, a, b: broadcast(a, b) if mask else b
    return lambda mask, a, b: a if mask else b


def _bind(function, operation) -> None:
    """Let a Python operator do an operation where one argument is a vector and the other a vector or a number."""

    @in_kernels(function)
    def of_vectors(a, b):
        if isinstance(a, Vector) and (a == b or isinstance(b, types.Number)):
            return lambda a, b: operation(a, broadcast(b, a))
        if isinstance(b, Vector) and isinstance(a, types.Number):
            return lambda a, b: operation(broadcast(a, b), b)
        return None


def _bind_choice(function, beats) -> None:
    """Let max or min, of a vector and a vector or a number, keep the lane that beats the other."""

    @in_kernels(function)
    def of_vectors(a, b):
        if isinstance(a, Vector):
            return lambda a, b: select(beats(a, b), a, broadcast(b, a))
        if isinstance(b, Vector):
            return lambda a, b: select(beats(b, a), b, broadcast(a, b))
        return None


for _operator in FLOAT_OPERATORS | INTEGER_OPERATORS:
    _of_floats = FLOAT_OPERATORS.get(_operator, "")
    _operation = _instruction(_of_floats, INTEGER_OPERATORS.get(_operator, ""))
    _bind(_operator, _operation)
    _bind(getattr(operator, f"i{_operator.__name__.rstrip('_')}"), _operation)  # a += b
for _name, _sign in COMPARISONS.items():
    _bind(getattr(operator, _name), _instruction("fcmp_ordered", "icmp_signed", _sign))
_bind_choice(max, operator.gt)
_bind_choice(min, operator.lt)


@in_kernels(operator.neg)
def _negative(x):
    return (lambda x: 0.0 - x) if isinstance(x, Vector) else None


@in_kernels(operator.ipow)
@in_kernels(operator.pow)
def _power(x, exponent):
    """The powers that laws use, one of which the compiler picks for a constant exponent; others lane by lane."""
    if isinstance(exponent, Vector) and (x == exponent or isinstance(x, types.Number)):
        return lambda x, exponent: _powers(broadcast(x, exponent), exponent)
    if not (isinstance(x, Vector) and isinstance(exponent, types.Number)):
        return None
    lanes = x.lanes

    def power(x, exponent):
        if exponent == 0.5:
            return _square_root(x)
        if exponent == 2:
            return x * x
        if exponent == 3:
            return x * x * x
        if exponent == -1:
            return 1.0 / x
        for k in range(lanes):
            x = with_lane(x, k, lane(x, k) ** exponent)
        return x

    return power


@scalar
def _powers(bases, exponents):
    """Lane by lane, as the processor has no instruction for it."""
    for k in range(count(bases)):
        bases = with_lane(bases, k, lane(bases, k) ** lane(exponents, k))
    return bases


def bind_one(function, operation=None) -> None:
    """Let a function of one number act on vectors: by an operation, or lane by lane if there is none."""

    @in_kernels(function)
    def of_vector(x):
        if not isinstance(x, Vector):
            return None
        if operation:
            return lambda x: operation(x)
        lanes = x.lanes

        def each(x):
            for k in range(lanes):
                x = with_lane(x, k, function(lane(x, k)))
            return x

        return each


_FUNCTIONS = {math.sqrt: _square_root, np.sqrt: _square_root, abs: _magnitude, np.floor: _floor}
for _function_of_one, _operation in {**_FUNCTIONS, **dict.fromkeys(LANE_BY_LANE)}.items():
    bind_one(_function_of_one, _operation)
