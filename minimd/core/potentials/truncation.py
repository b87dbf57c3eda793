"""Truncations: functions of a law, so that each law is written without a cutoff.

Beyond the cutoff r_c every truncated law is zero; the loop sees to that. Inside,
the truncation determines how u goes to zero:

    truncated       u(r)                                          jumps at r_c
    shifted         u(r) − u(r_c)                                 u continuous, force jumps
    force-shifted   u(r) − u(r_c) − (r − r_c) u′(r_c)             u and force continuous (NIST: linear force shift)
    switched        u(r) S(x), x = (r − r_on)/(r_c − r_on)        u, force and its slope continuous (C²)
    charmm          u(r) C(r²) between r_on and r_c               u and force continuous; ASE's smooth=True
    smooth          u(r) S(y), y = (r² − r_on²)/(r_c² − r_on²)    seven derivatives continuous (C⁷)

A method keeps its order only where u is smooth enough: an atom that crosses a jump of the k-th derivative is left with
an error of Δtᵏ in its energy, whatever the method. So switched laws are for methods up to order 3, smooth ones up to 8.
"""

from collections.abc import Callable
from math import sqrt
from typing import Literal, NamedTuple

from minimd.core.compiled.kernels import scalar
from minimd.core.potentials.law import evaluate_law, law_at, law_type


@scalar
def shifted(r2, law, parameters):
    """u(r) − u(r_c); the force is that of the law.
    parameters : (u(r_c), *parameters of law)."""
    u, f = evaluate_law(law, r2, parameters[1:])
    return u - parameters[0], f


@scalar
def force_shifted(r2, law, parameters):
    """u(r) − u(r_c) − (r − r_c) u′(r_c).
    parameters : (u(r_c), u′(r_c), r_c, *parameters of law).
    M. P. Allen, D. J. Tildesley, Computer Simulation of Liquids, 2nd ed. (2017), eq. 5.6-5.8."""
    u, f = evaluate_law(law, r2, parameters[3:])
    r = sqrt(r2)
    return u - parameters[0] - (r - parameters[2]) * parameters[1], f + parameters[1] / r


@scalar
def switched(r2, law, parameters):
    """u(r) S(x) with S = 1 − 10x³ + 15x⁴ − 6x⁵ and x = (r − r_on)/(r_c − r_on) within [0, 1]; S, S′, S″ continuous.
    parameters : (r_on, r_c, *parameters of law).
    D. van der Spoel, P. J. van Maaren, J. Chem. Theory Comput. 2, 1 (2006)."""
    u, f = evaluate_law(law, r2, parameters[2:])
    r = sqrt(r2)
    width = parameters[1] - parameters[0]
    x = max(0.0, min(1.0, (r - parameters[0]) / width))
    s = 1.0 + x * x * x * (x * (15.0 - 6.0 * x) - 10.0)
    slope = -30.0 * x * x * (1.0 - x) * (1.0 - x) / width
    return s * u, s * f - slope * u / r


@scalar
def charmm(r2, law, parameters):
    """u(r) C with C = (r_c² − r²)² (r_c² + 2r² − 3r_on²)/(r_c² − r_on²)³ beyond r_on, 1 before; u and force continuous.
    parameters : (r_on², r_c², *parameters of law).  B. R. Brooks et al., J. Comput. Chem. 4, 187 (1983)."""
    u, f = evaluate_law(law, r2, parameters[2:])
    on2 = parameters[0]
    off2 = parameters[1]
    y = max(on2, min(off2, r2))
    scale = 1.0 / (off2 - on2) ** 3
    c = (off2 - y) * (off2 - y) * (off2 + 2.0 * y - 3.0 * on2) * scale
    slope = 6.0 * (off2 - y) * (on2 - y) * scale  # dC/d(r²)
    return c * u, c * f - 2.0 * slope * u


@scalar
def smooth(r2, law, parameters):
    """u(r) S(y), y = (r² − r_on²)/(r_c² − r_on²) in [0, 1], S the polynomial of degree 15 that falls from 1 to 0 with

        S(y) = (1 − y)⁸ Σₖ C(7 + k, k) yᵏ, k = 0 … 7,   S′(y) = −15!/(7!)² y⁷ (1 − y)⁷

    so that seven derivatives vanish at both ends: the incomplete beta function I₁₋ᵧ(8, 8), NIST DLMF 8.17.
    All terms are positive.
    parameters : (r_on², r_c², *parameters of law).
    """
    u, f = evaluate_law(law, r2, parameters[2:])
    scale = 1.0 / (parameters[1] - parameters[0])
    y = max(0.0, min(1.0, (r2 - parameters[0]) * scale))
    z = 1.0 - y
    y3 = y * y * y
    z3 = z * z * z
    upper = 330.0 + y * (792.0 + y * (1716.0 + y * 3432.0))
    series = 1.0 + y * (8.0 + y * (36.0 + y * (120.0 + y * upper)))
    s = z3 * z3 * z * z * series
    slope = -51480.0 * y3 * y3 * y * z3 * z3 * z * scale  # dS/d(r²)
    return s * u, s * f - 2.0 * slope * u


class Truncation(NamedTuple):
    """around : makes the law type of the truncated law.
    numbers : makes the parameters of its formula, from the law, its parameters, r_c and r_on."""

    around: Callable[[tuple], tuple]
    numbers: Callable[[tuple, tuple, float, float], tuple]


def _value(law: tuple, parameters: tuple, r_c: float, _r_on: float) -> tuple:
    return law_at(law, r_c, parameters)[:1]


def _value_and_slope(law: tuple, parameters: tuple, r_c: float, _r_on: float) -> tuple:
    u, f = law_at(law, r_c, parameters)
    return u, -f * r_c, r_c


def _squares(_law: tuple, _parameters: tuple, r_c: float, r_on: float) -> tuple:
    return r_on * r_on, r_c * r_c


Shifted = law_type("Shifted", shifted)
ForceShifted = law_type("ForceShifted", force_shifted)
Switched = law_type("Switched", switched)
CharmmSwitched = law_type("CharmmSwitched", charmm)
Smooth = law_type("Smooth", smooth)

TRUNCATIONS = {
    "truncated": Truncation(lambda law: law, lambda *_: ()),
    "shifted": Truncation(Shifted, _value),
    "force-shifted": Truncation(ForceShifted, _value_and_slope),
    "switched": Truncation(Switched, lambda law, parameters, r_c, r_on: (r_on, r_c)),
    "charmm": Truncation(CharmmSwitched, _squares),
    "smooth": Truncation(Smooth, _squares),
}

# the keys of TRUNCATIONS
TruncationName = Literal["truncated", "shifted", "force-shifted", "switched", "charmm", "smooth"]
SWITCHES = ("switched", "charmm", "smooth")  # those that start at r_on
