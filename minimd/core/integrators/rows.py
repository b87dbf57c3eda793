"""Splittings, each a row of kicks and drifts of a paper or a closed form, and compositions; timestep : Δt [time].

    (A) = SE2 ∘ SE1 over Δt/2 each = velocity Verlet        (B) = SE1 ∘ SE2 over Δt/2 each = position Verlet

No sequence of positive coefficients has an order above 2, so those here have a negative coefficient (Q. Sheng, IMA J.
Numer. Anal. 9, 199 (1989); M. Suzuki, J. Math. Phys. 32, 400 (1991)). Surveys: E. Hairer, C. Lubich, G. Wanner, Acta
Numerica 12, 399 (2003), and Geometric Numerical Integration (2006), V.3; R. I. McLachlan, G. R. W. Quispel, Acta
Numerica 11, 341 (2002).
"""

from collections.abc import Sequence
from itertools import chain

import numpy as np

from minimd.core.console.words import shown
from minimd.core.integrators.method import check_class
from minimd.core.integrators.splitting import Splitting
from minimd.core.integrators.substeps import (
    Drift,
    Kick,
    Substep,
    Substeps,
    alternating,
    merged,
    mirrored,
    palindrome,
    repeated,
    scaled,
)
from minimd.core.structure.checks import checked_numbers

__all__ = [
    "PEFRL",
    "SE1",
    "SE2",
    "BlanesMoan4",
    "CandyRozmus4",
    "KahanLi6",
    "KahanLi8",
    "Leapfrog",
    "McLachlanAtela4",
    "PositionVerlet",
    "Ruth3",
    "Suzuki4",
    "VelocityVerlet",
    "Yoshida6",
    "adjoint",
    "compose",
]


class VelocityVerlet(Splitting):
    """Velocity Verlet, Störmer-Verlet (A): order 2, symplectic, time-reversible, one force evaluation per step.

    v(t+Δt/2) = v(t) + Δt/2 F(t)/m              kick
    r(t+Δt)   = r(t) + Δt v(t+Δt/2)             drift
    F(t+Δt)   = −∇U(r(t+Δt))
    v(t+Δt)   = v(t+Δt/2) + Δt/2 F(t+Δt)/m      kick"""

    name = "velocity-verlet"
    substeps = (Kick(0.5), Drift(1.0), Kick(0.5))
    source = "W. C. Swope et al., J. Chem. Phys. 76, 637 (1982), eq. 16-17"


class PositionVerlet(Splitting):
    """Position Verlet, Störmer-Verlet (B): the same two flows with the drifts outside.

    r(t+Δt/2) = r(t) + Δt/2 v(t)                drift
    v(t+Δt)   = v(t) + Δt F(t+Δt/2)/m           kick
    r(t+Δt)   = r(t+Δt/2) + Δt/2 v(t+Δt)        drift"""

    name = "position-verlet"
    substeps = (Drift(0.5), Kick(1.0), Drift(0.5))
    source = "M. Tuckerman, B. J. Berne, G. J. Martyna, J. Chem. Phys. 97, 1990 (1992), eq. 2.22"


class Leapfrog(Splitting):
    """Leapfrog: velocities at half steps.

        v(t+Δt/2) = v(t−Δt/2) + Δt F(t)/m           kick
        r(t+Δt)   = r(t) + Δt v(t+Δt/2)             drift

    The kick is made as two halves, so that velocities, energies and files show v(t) together with r(t), at any step:
    to the last bit this is velocity Verlet."""

    name = "leapfrog"
    substeps = (Kick(0.5), Drift(1.0), Kick(0.5))
    source = "R. W. Hockney, J. W. Eastwood, Computer Simulation Using Particles (1981), 4-3-1"


class SE1(Splitting):
    """Symplectic Euler, kick first: order 1, not symmetric; its adjoint is SE2.

    v(t+Δt) = v(t) + Δt F(t)/m                  kick
    r(t+Δt) = r(t) + Δt v(t+Δt)                 drift"""

    name = "symplectic-euler-1"
    substeps = (Kick(1.0), Drift(1.0))
    source = "E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration (2006), VI.3"


class SE2(Splitting):
    """Symplectic Euler, drift first: order 1, not symmetric; its adjoint is SE1.

    r(t+Δt) = r(t) + Δt v(t)                    drift
    v(t+Δt) = v(t) + Δt F(t+Δt)/m               kick"""

    name = "symplectic-euler-2"
    substeps = (Drift(1.0), Kick(1.0))
    source = "E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration (2006), VI.3"


CBRT2 = 2.0 ** (1.0 / 3.0)
CBRT4 = 4.0 ** (1.0 / 3.0)
Part = Substep | type[Splitting]


def compose(*parts: Part, weights: Sequence[float] | None = None) -> type[Splitting]:
    """The method Φ¹ ∘ Φ² ∘ … ∘ Φˢ: the last one acts first, as in the formula.

    So compose(SE2, SE1) is Störmer-Verlet (A), compose(SE1, SE2) is (B), compose(Drift(1.0), Kick(1.0)) is SE1, and
    compose(*3 * [VelocityVerlet], weights=[g, 1 - 2 * g, g]) with g = 1/(2 − ∛2) has order 4.

    Parameters
    ----------
    parts : methods, or flows Kick(c) and Drift(c).
    weights : fraction of the time step for each part. If not given, methods get equal fractions,
        and each flow lasts its own cΔt.

    Raises
    ------
    TypeError : for parts of another kind or with a bath, or methods mixed with flows without weights.
    ValueError : if there are no parts, or not as many weights as parts, all finite numbers.
    """
    rows: list[Substeps] = []
    names = []
    for part in parts:
        if isinstance(part, Kick | Drift):
            rows.append((part,))
            names.append(repr(part))
        elif isinstance(part, type) and issubclass(part, Splitting):
            rows.append(_undoable(part))
            names.append(part.name)
        else:
            raise TypeError(
                f"parts must be methods, such as VelocityVerlet, or flows, such as Kick(0.5); got {shown(part)}"
            )
    if weights is None:
        n_methods = sum(isinstance(part, type) for part in parts)
        if 0 < n_methods < len(parts):
            raise TypeError(
                "methods and flows can be mixed only if weights are given: the fraction of the time step for each part"
            )
        weights = [1.0 / n_methods if n_methods else 1.0] * len(parts)
    expected = "finite numbers, one for each part"
    fractions = checked_numbers("weights", weights, expected)
    if fractions.ndim != 1 or not np.isfinite(fractions).all():
        raise ValueError(f"weights must be {expected}; weights = {shown(weights)}")
    if len(fractions) != len(parts) or not parts:
        raise ValueError(
            "there must be at least one part, and as many weights as parts; "
            f"got {len(parts)} parts, {len(fractions)} weights"
        )
    title = " ∘ ".join(names)
    sequences = map(scaled, reversed(rows), reversed(fractions.tolist()))
    substeps = merged(chain.from_iterable(sequences))
    return _method(f"compose({title})", substeps, f"composition of its parts, {title}")


def adjoint(method: type[Splitting]) -> type[Splitting]:
    """The adjoint Φ*_Δt = (Φ_{−Δt})⁻¹: the substeps in reverse.

    With the opposite time step it undoes a step of the method.

    Raises
    ------
    TypeError : for a method with a bath, which cannot be undone, or anything but a method.
    """
    check_class(method, Splitting)
    substeps = mirrored(_undoable(method))
    name = method.name
    return _method(f"adjoint({name})", substeps, f"adjoint of {name}: {method.source}")


def _undoable(method: type[Splitting]) -> Substeps:
    """The sequence of a method without a bath."""
    if method.is_thermostat:
        raise TypeError(
            f"{method.name} is a thermostat: its steps can be neither inverted nor divided into fractions"
        )
    return method.sequence()


def _method(name: str, substeps: Substeps, source: str) -> type[Splitting]:
    members = {"name": name, "substeps": substeps, "source": source, "__doc__": f"{name}."}
    return type("Composition", (Splitting,), members)


class Ruth3(Splitting):
    """Ruth's method of order 3, the first with an order above 2: three kicks, not symmetric.

    kicks 7/24, 3/4, −1/24, each followed by its drift 2/3, −2/3, 1."""

    name = "ruth-3"
    substeps = (Kick(7 / 24), Drift(2 / 3), Kick(3 / 4), Drift(-2 / 3), Kick(-1 / 24), Drift(1.0))
    source = "R. D. Ruth, IEEE Trans. Nucl. Sci. 30, 2669 (1983)"


class CandyRozmus4(Splitting):
    """Candy-Rozmus = Forest-Ruth = Yoshida's triple jump over position Verlet: order 4, three kicks.

    drifts a₁ = a₄ = (2 + ∛2 + 1/∛2)/6,  a₂ = a₃ = (1 − ∛2 − 1/∛2)/6
    kicks  b₁ = b₃ = 1/(2 − ∛2) = 2a₁,   b₂ = 1/(1 − ∛4) = −∛2 b₁"""

    name = "candy-rozmus-4"
    _a1 = (2.0 + CBRT2 + 1.0 / CBRT2) / 6.0
    _a2 = (1.0 - CBRT2 - 1.0 / CBRT2) / 6.0
    _b1 = 1.0 / (2.0 - CBRT2)
    _b2 = 1.0 / (1.0 - CBRT4)
    substeps = alternating(Drift, palindrome((_a1, _b1, _a2, _b2)))
    source = (
        "J. Candy, W. Rozmus, J. Comput. Phys. 92, 230 (1991); E. Forest, R. D. Ruth, Physica D 43, 105 (1990); "
        "H. Yoshida, Phys. Lett. A 150, 262 (1990)"
    )


class Suzuki4(Splitting):
    """Suzuki's fractal of five velocity Verlet steps: order 4, five kicks, smaller errors than with three.

    γ₁ = γ₂ = γ₄ = γ₅ = 1/(4 − ∛4),  γ₃ = 1 − 4γ₁ = −∛4 γ₁"""

    name = "suzuki-4"
    _g1 = 1.0 / (4.0 - CBRT4)
    _g3 = -CBRT4 / (4.0 - CBRT4)
    substeps = repeated(VelocityVerlet.substeps, palindrome((_g1, _g1, _g3)))
    source = "M. Suzuki, Phys. Lett. A 146, 319 (1990)"


class McLachlanAtela4(Splitting):
    """McLachlan and Atela's optimal method of order 4 for quadratic kinetic energy: four kicks, not symmetric.

    For other T(p) it has only order 3: it relies on a kinetic energy p²/2m, as it is here."""

    name = "mclachlan-atela-4"
    _b1 = 0.1344961992774310892
    _b2 = -0.2248198030794208058
    _b3 = 0.7563200005156682911
    _b4 = 0.3340036032863214255
    _a1 = 0.5153528374311229364
    _a2 = -0.085782019412973646
    _a3 = 0.4415830236164665242
    _a4 = 0.1288461583653841854
    substeps = alternating(Kick, (_b1, _a1, _b2, _a2, _b3, _a3, _b4, _a4))
    source = "R. I. McLachlan, P. Atela, Nonlinearity 5, 541 (1992)"


class PEFRL(Splitting):
    """The position extended Forest-Ruth-like method: order 4, four kicks, its free parameters chosen for a small error.

    drifts ξ, χ, 1 − 2(χ + ξ), χ, ξ;  kicks (1 − 2λ)/2, λ, λ, (1 − 2λ)/2"""

    name = "pefrl"
    _xi = 0.1786178958448091
    _lambda = -0.2123418310626054
    _chi = -0.06626458266981849
    _half = (_xi, (1.0 - 2.0 * _lambda) / 2.0, _chi, _lambda, 1.0 - 2.0 * (_chi + _xi))
    substeps = alternating(Drift, palindrome(_half))
    source = "I. P. Omelyan, I. M. Mryglod, R. Folk, Comput. Phys. Commun. 146, 188 (2002)"


class BlanesMoan4(Splitting):
    """Blanes and Moan's Nyström method SRKN₆ᵇ: order 4, six kicks,
    the smallest error per force evaluation of order 4 here.

    Its free parameters are chosen so that the error terms of order 5 left for quadratic kinetic energy are small."""

    name = "blanes-moan-rkn-4"
    _a1 = 0.245298957184271
    _a2 = 0.604872665711080
    _a3 = 0.5 - (_a1 + _a2)
    _b1 = 0.0829844064174052
    _b2 = 0.396309801498368
    _b3 = -0.0390563049223486
    _b4 = 1.0 - 2.0 * (_b1 + _b2 + _b3)
    substeps = alternating(Kick, palindrome((_b1, _a1, _b2, _a2, _b3, _a3, _b4)))
    source = "S. Blanes, P. C. Moan, J. Comput. Appl. Math. 142, 313 (2002), table 3"


class Yoshida6(Splitting):
    """Yoshida's solution A: order 6 from seven steps of velocity Verlet, seven kicks."""

    name = "yoshida-6"
    _w1 = -1.17767998417887100695
    _w2 = 0.23557321335935813368
    _w3 = 0.78451361047755726382
    _w0 = 1.0 - 2.0 * (_w1 + _w2 + _w3)
    substeps = repeated(VelocityVerlet.substeps, palindrome((_w3, _w2, _w1, _w0)))
    source = "H. Yoshida, Phys. Lett. A 150, 262 (1990), table 1, solution A"


class KahanLi6(Splitting):
    """Kahan and Li's s9odr6a: order 6 from nine steps of velocity Verlet, smaller errors than with seven."""

    name = "kahan-li-6"
    _w = (
        0.39216144400731413928,
        0.33259913678935943860,
        -0.70624617255763935981,
        0.08221359629355080023,
        0.79854399093482996340,
    )
    substeps = repeated(VelocityVerlet.substeps, palindrome(_w))
    source = "W. Kahan, R.-C. Li, Math. Comput. 66, 1089 (1997), s9odr6a"


class KahanLi8(Splitting):
    """Kahan and Li's s17odr8a: order 8 from seventeen steps of velocity Verlet."""

    name = "kahan-li-8"
    _w = (
        0.13020248308889008088,
        0.56116298177510838456,
        -0.38947496264484728641,
        0.15884190655515560090,
        -0.39590389413323757734,
        0.18453964097831570709,
        0.25837438768632204729,
        0.29501172360931029887,
        -0.60550853383003451170,
    )
    substeps = repeated(VelocityVerlet.substeps, palindrome(_w))
    source = "W. Kahan, R.-C. Li, Math. Comput. 66, 1089 (1997), s17odr8a"
