"""What laws need of vectors: operators, comparisons, choices, functions."""

import math
import operator

import numpy as np
from numba import types
from numba.extending import intrinsic, overload

from minimd.compiled.simd.vector import Vector, broadcast, call, lane, with_lane

FLOAT_OPERATORS = {
    operator.add: "fadd",
    operator.sub: "fsub",
    operator.mul: "fmul",
    operator.truediv: "fdiv",
}  # methods of IRBuilder
INTEGER_OPERATORS = {
    operator.add: "add",
    operator.sub: "sub",
    operator.mul: "mul",
    operator.and_: "and_",
    operator.or_: "or_",
}
COMPARISONS = {
    operator.lt: "<",
    operator.le: "<=",
    operator.gt: ">",
    operator.ge: ">=",
    operator.eq: "==",
    operator.ne: "!=",
}
LANE_BY_LANE = (
    math.exp,
    math.log,
    math.sin,
    math.cos,
    math.tanh,
    math.erf,
    math.erfc,
    np.exp,
    np.log,
    np.sin,
    np.cos,
    np.tanh,
)


def _instruction(of_floats: str, of_integers: str, *sign: str):
    """An intrinsic for two vectors of one type: IRBuilder's methods for floats and for integers,
    and the sign of a comparison."""

    @intrinsic
    def operation(_context, a, b):
        method = of_floats if a.is_float else of_integers
        return (a.mask if sign else a)(a, b), lambda context, builder, signature, arguments: getattr(builder, method)(
            *sign, *arguments
        )

    return operation


def _function(name: str):
    """An intrinsic for one of LLVM's functions whose argument and result are of one vector type."""

    @intrinsic
    def one(_context, a):
        return a(a), lambda context, builder, signature, arguments: call(
            builder, f"llvm.{name}.{a.suffix}", arguments[0].type, arguments
        )

    return one


_square_root, _magnitude, _floor = _function("sqrt"), _function("fabs"), _function("floor")


@intrinsic
def _multiply_add(_context, a, b, c):
    suffix = a.suffix if isinstance(a, Vector) else f"f{a.bitwidth}"
    return a(a, b, c), lambda context, builder, signature, arguments: call(
        builder, f"llvm.fmuladd.{suffix}", arguments[0].type, arguments
    )


def fma(a, b, c):
    """a · b + c for three numbers or three vectors of one type,
    rounded once where the processor has an instruction for it; c may be a number."""
    return a * b + c


@overload(fma)
def _fma(a, b, c):
    if isinstance(a, Vector):
        return lambda a, b, c: _multiply_add(a, b, broadcast(c, a))
    return lambda a, b, c: _multiply_add(a, b, c)


@intrinsic
def _choose(_context, mask, a, b):
    return a(mask, a, b), lambda context, builder, signature, arguments: builder.select(*arguments)


def select(mask, a, b):
    """Lane by lane: a where the mask is set, b elsewhere; b may be a number. For numbers: a if mask else b."""
    return a if mask else b


@overload(select)
def _select(mask, a, b):
    if isinstance(mask, Vector):
        return lambda mask, a, b: _choose(mask, a, broadcast(b, a))
    return lambda mask, a, b: a if mask else b


def _bind(function, operation) -> None:
    """Let a Python operator of two arguments do an operation where one of them is a
    vector and the other a vector or a number."""

    @overload(function)
    def of_vectors(a, b):
        if isinstance(a, Vector) and (a == b or isinstance(b, types.Number)):
            return lambda a, b: operation(a, broadcast(b, a))
        return (
            (lambda a, b: operation(broadcast(a, b), b))
            if isinstance(b, Vector) and isinstance(a, types.Number)
            else None
        )


def _bind_choice(function, beats) -> None:
    """Let max or min, of a vector and a vector or a number, keep the lane that beats the other."""

    @overload(function)
    def of_vectors(a, b):
        if isinstance(a, Vector):
            return lambda a, b: select(beats(a, b), a, broadcast(b, a))
        return (lambda a, b: select(beats(b, a), b, broadcast(a, b))) if isinstance(b, Vector) else None


for _operator in FLOAT_OPERATORS | INTEGER_OPERATORS:
    _bind(_operator, _instruction(FLOAT_OPERATORS.get(_operator, ""), INTEGER_OPERATORS.get(_operator, "")))
for _operator, _sign in COMPARISONS.items():
    _bind(_operator, _instruction("fcmp_ordered", "icmp_signed", _sign))
_bind_choice(max, operator.gt)
_bind_choice(min, operator.lt)


@overload(operator.neg)
def _negative(x):
    return (lambda x: 0.0 - x) if isinstance(x, Vector) else None


@overload(operator.pow)
def _power(x, exponent):
    """The powers that laws are written with; the compiler picks one where the exponent is a constant.

    Others lane by lane.
    """
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


def _bind_one(function, operation=None) -> None:
    """Let a function of one number act on vectors: by an operation, or lane by lane if there is none."""

    @overload(function)
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


_FUNCTIONS = {
    math.sqrt: _square_root,
    np.sqrt: _square_root,
    abs: _magnitude,
    np.floor: _floor,
    **dict.fromkeys(LANE_BY_LANE),
}
for _one, _operation in _FUNCTIONS.items():
    _bind_one(_one, _operation)
