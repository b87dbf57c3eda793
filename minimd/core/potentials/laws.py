"""The laws, each written once, as a function of its variable and its parameters.

    law(r2, …)         of a squared distance, > 0 [length²]: u [energy] and −u′(r)/r [energy/length²]
    law(phi, …)        of a dihedral angle [rad]: u [energy] and u′(φ) [energy/rad]
    law(phi, psi, …)   of two of them: u [energy], ∂u/∂φ and ∂u/∂ψ [energy/rad]
    law(x, y, z, t, …) of fields: u [energy], the force on the atom [energy/length] and ∂u/∂t [energy/time]

φ is zero where the first and the last atom lie on one side (cis), and π or −π where they lie on opposite sides (trans):
IUPAC's convention. Laws of walls hold a law u(r) of the distance from the wall inside.
"""

from math import cos, exp, log, nan, pi, sin, sqrt

import numpy as np

from minimd.core.compiled.kernels import scalar
from minimd.core.compiled.simd import select
from minimd.core.potentials.law import evaluate_law, law_type
from minimd.core.potentials.splines import cubic


@scalar
def lennard_jones(r2, epsilon, sigma):
    """Lennard-Jones 12-6 law.

        u(r)     = 4ε [(σ/r)¹² − (σ/r)⁶]
        −u′(r)/r = 24ε/r² [2(σ/r)¹² − (σ/r)⁶]

    epsilon : depth of the well, at r = 2^(1/6) σ [energy].
    sigma : distance where u = 0 [length].
    J. E. Lennard-Jones, Proc. Phys. Soc. 43, 461 (1931).
    """
    s2 = sigma * sigma / r2
    s6 = s2 * s2 * s2
    scale = 24.0 * epsilon / (sigma * sigma)  # taken out of the loop where all pairs share it
    return 4.0 * epsilon * s6 * (s6 - 1.0), (2.0 * scale * s6 - scale) * (s6 * s2)


@scalar
def harmonic(r2, k, length):
    """Harmonic bond.

        u(r)     = ½ k (r − r₀)²
        −u′(r)/r = −k (r − r₀)/r, and −k for r₀ = 0, where two atoms may be at the same place

    r2 : may be 0 for r₀ = 0.
    k : stiffness [energy/length²].
    length : r₀, at the minimum [length].
    """
    r = sqrt(r2)
    stretch = r - length
    return 0.5 * k * stretch * stretch, select(length == 0.0, -k, -k * stretch / r)


@scalar
def morse(r2, depth, a, length):
    """Morse bond.

        u(r)     = D (1 − x)²,  x = exp[−a (r − r₀)]
        −u′(r)/r = −2 a D (1 − x) x / r

    depth : D, energy that breaks the bond [energy].
    a : its inverse width [1/length]; the stiffness at rest is 2 a² D.
    length : r₀, distance of the minimum [length].  P. M. Morse, Phys. Rev. 34, 57 (1929).
    """
    r = sqrt(r2)
    x = exp(-a * (r - length))
    return depth * (1.0 - x) * (1.0 - x), -2.0 * a * depth * (1.0 - x) * x / r


@scalar
def fene(r2, k, longest, epsilon, sigma):
    """Finitely extensible bond with the repulsion of its beads.

        u(r)     = −½ k R² ln(1 − (r/R)²) + [4ε ((σ/r)¹² − (σ/r)⁶) + ε below r = 2^(1/6) σ]
        −u′(r)/r = −k / (1 − (r/R)²)      + [24ε/r² (2(σ/r)¹² − (σ/r)⁶)          likewise]

    k : stiffness [energy/length²].
    longest : R, which the bond cannot reach [length]; NaN from R on.
    epsilon, sigma : of the repulsion [energy], [length].  K. Kremer, G. S. Grest, J. Chem. Phys. 92, 5057 (1990).
    """
    rest = 1.0 - r2 / (longest * longest)
    rest = select(rest > 0.0, rest, nan)
    repulsion, push = lennard_jones(r2, epsilon, sigma)
    is_near = 2.0 * (sigma * sigma / r2) ** 3 > 1.0
    u = -0.5 * k * longest * longest * log(rest) + select(is_near, repulsion + epsilon, 0.0)
    return u, -k / rest + select(is_near, push, 0.0)


@scalar
def lennard_jones_93(r2, epsilon, sigma):
    """Lennard-Jones 9-3 law, of an atom in front of a half-space of Lennard-Jones atoms.

        u(r)     = ε [2/15 (σ/r)⁹ − (σ/r)³]
        −u′(r)/r = ε/r² [6/5 (σ/r)⁹ − 3 (σ/r)³]

    epsilon : ε; the well is √10/3 ε deep, at r = (2/5)^(1/6) σ [energy].
    sigma : [length].
    W. A. Steele, Surf. Sci. 36, 317 (1973).
    """
    s2 = sigma * sigma / r2
    s3 = s2 * sqrt(s2)
    s9 = s3 * s3 * s3
    return epsilon * (2.0 / 15.0 * s9 - s3), epsilon / r2 * (1.2 * s9 - 3.0 * s3)


@scalar
def mie(r2, epsilon, sigma, n, m):
    """Mie n-m law.

        u(r)     = C ε [(σ/r)ⁿ − (σ/r)ᵐ],   C = n/(n − m) (n/m)^(m/(n − m))
        −u′(r)/r = C ε/r² [n (σ/r)ⁿ − m (σ/r)ᵐ]

    epsilon : depth of the well, at r = (n/m)^(1/(n − m)) σ [energy].
    sigma : distance where u = 0 [length].
    n, m : exponents, n > m > 0, whole or not.
    G. Mie, Ann. Phys. 316, 657 (1903); C of unit depth: C. Avendaño et al., J. Phys. Chem. B 115, 11154 (2011).
    """
    x = 0.5 * log(sigma * sigma / r2)
    repulsion = exp(n * x)
    attraction = exp(m * x)
    scale = epsilon * n / (n - m) * exp(m / (n - m) * log(n / m))
    return scale * (repulsion - attraction), scale * (n * repulsion - m * attraction) / r2


@scalar
def soft_repulsion(r2, height, reach):
    """Soft repulsion, a cosine.

        u(r)     = A [1 + cos(πr/r_c)]
        −u′(r)/r = A π/(r_c r) sin(πr/r_c), and A (π/r_c)² at r = 0, where two atoms may be at the same place

    height : A, half of u at r = 0 [energy].
    reach : r_c, where energy and force vanish [length].
    LAMMPS, pair_style soft; such ramps in melts: R. Auhl et al., J. Chem. Phys. 119, 12718 (2003).
    """
    r = sqrt(r2)
    wave = pi / reach
    slope = select(r2 > 0.0, sin(wave * r) / r, wave)
    return height * (1.0 + cos(wave * r)), height * wave * slope


@scalar
def quartic(r2, k2, k3, k4, length):
    """Quartic bond.

        u(r)     = k₂ x² + k₃ x³ + k₄ x⁴,   x = r − r₀
        −u′(r)/r = −x (2k₂ + 3k₃ x + 4k₄ x²)/r

    k2, k3, k4 : [energy/length²], [energy/length³], [energy/length⁴].
    length : r₀ [length].
    M. J. Hwang, T. P. Stockfisch, A. T. Hagler, J. Am. Chem. Soc. 116, 2515 (1994), eq. 1.
    """
    r = sqrt(r2)
    x = r - length
    return x * x * (k2 + x * (k3 + x * k4)), -x * (2.0 * k2 + x * (3.0 * k3 + x * 4.0 * k4)) / r


@scalar
def scaled(r2, law, parameters):
    """A law times a constant factor, the first of its parameters [dimensionless]: for pairs a few bonds apart.
    parameters : (factor, *parameters of law)."""
    u, f = evaluate_law(law, r2, parameters[1:])
    return parameters[0] * u, parameters[0] * f


@scalar
def periodic(phi, k, n, phase):
    """Periodic torsion.

        u(φ)  = k [1 + cos(nφ − φ₀)]
        u′(φ) = −n k sin(nφ − φ₀)

    k : half the barrier [energy].
    n : number of minima in a turn.
    phase : φ₀ [rad].
    """
    x = n * phi - phase
    return k * (1.0 + cos(x)), -n * k * sin(x)


@scalar
def ryckaert_bellemans(phi, c0, c1, c2, c3, c4, c5):
    """Torsion as a polynomial in the cosine of ψ = φ − π, which is zero if the chain is stretched (trans).

        u(φ)  = Σ cₙ xⁿ,  x = cos ψ = −cos φ
        u′(φ) = (Σ n cₙ xⁿ⁻¹) sin φ

    c0 … c5 : [energy].  J.-P. Ryckaert, A. Bellemans, Chem. Phys. Lett. 30, 123 (1975).
    """
    x = -cos(phi)
    u = c0 + x * (c1 + x * (c2 + x * (c3 + x * (c4 + x * c5))))
    slope = c1 + x * (2.0 * c2 + x * (3.0 * c3 + x * (4.0 * c4 + x * 5.0 * c5)))
    return u, slope * sin(phi)


@scalar
def harmonic_torsion(phi, k, angle):
    """Harmonic improper.

        u(φ)  = ½ k x²,  x = φ − φ₀ minus the nearest multiple of 2π
        u′(φ) = k x

    k : stiffness [energy/rad²].
    angle : φ₀ [rad].
    """
    x = phi - angle
    x -= 2.0 * pi * np.floor(x / (2.0 * pi) + 0.5)
    return 0.5 * k * x * x, k * x


@scalar
def _step_of(angle, n):
    """The step in which an angle lies, of n in a turn, from 0 on, and the part of it that is behind it."""
    x = angle * (n / (2.0 * pi))
    start = np.floor(x)
    step = int(start) if start == start else 0
    return step % n, x - start


@scalar
def dihedral_map(phi, coefficients, parameters):
    """A map of two dihedral angles.

        u(φ, ψ) = Σ cₖₗ sᵏ tˡ, k, l = 0 … 3,   s, t : the parts of a step that are behind φ and ψ

    coefficients : (M, n, n, 4, 4) c of M maps with n steps in a turn of each angle [energy].
    parameters : (ψ [rad], number of the map).
    A. D. MacKerell Jr., M. Feig, C. L. Brooks III, J. Comput. Chem. 25, 1400 (2004).
    """
    psi, m = parameters
    n = coefficients.shape[1]
    i, s = _step_of(phi, n)
    j, t = _step_of(psi, n)
    u = slope = other = 0.0
    for k in range(3, -1, -1):
        c = coefficients[int(m), i, j, k]
        value, along = cubic(t, c[0], c[1], c[2], c[3])
        slope = slope * s + u
        u = u * s + value
        other = other * s + along
    per_step = n / (2.0 * pi)
    return u, slope * per_step, other * per_step


@scalar
def constant(x, y, z, _t, fx, fy, fz):
    """Constant force: u = −F·r.
    x, y, z : position [length].
    fx, fy, fz : F [energy/length]."""
    return -(fx * x + fy * y + fz * z), fx, fy, fz, 0.0


@scalar
def restraint(x, y, z, _t, kx, ky, kz, vx, vy, vz):
    """Harmonic spring to a point that may move.

        u = ½ (kₓ x² + k_y y² + k_z z²),   F = −(kₓ x, k_y y, k_z z),   ∂u/∂t = F·v

    x, y, z : relative to the point [length].  kx … : stiffness [energy/length²].  vx … : velocity of the point.
    """
    fx, fy, fz = -kx * x, -ky * y, -kz * z
    return -0.5 * (fx * x + fy * y + fz * z), fx, fy, fz, fx * vx + fy * vy + fz * vz


@scalar
def _in_front(d, law, reach, parameters):
    """u(d) and −u′(d) for 0 < d < reach; zero farther away, NaN on the wall and behind it."""
    if d >= reach:
        return 0.0, 0.0
    if not d > 0.0:
        return nan, nan
    u, f = evaluate_law(law, d * d, parameters)
    return u, f * d


@scalar
def planar(x, law, parameters):
    """Wall in a plane: u(d) of the distance d = n·r − p, see _in_front.

    x : first coordinate [length].
    law : of d.
    parameters : (y, z, t, n, p, reach, *parameters of law); n is a unit vector, three numbers.
    """
    y, z, _, nx, ny, nz, place, reach = parameters[:8]
    u, f = _in_front(nx * x + ny * y + nz * z - place, law, reach, parameters[8:])
    return u, f * nx, f * ny, f * nz, 0.0


@scalar
def curved(x, law, parameters):
    """Wall of a cylinder or a sphere, with atoms inside: u(d) of the distance d = R − ρ, see _in_front.

    ρ = |r − (a·r) a| with r relative to a point on the axis; a = 0 makes it a sphere. The force points inwards,
    along −(r − (a·r) a)/ρ.

    x : first coordinate relative to the point [length].
    law : of d.
    parameters : (y, z, t, a, R, reach, *parameters of law); a is a unit vector or 0.
    """
    y, z, _, ax, ay, az, radius, reach = parameters[:8]
    along = ax * x + ay * y + az * z
    px, py, pz = x - along * ax, y - along * ay, z - along * az
    rho = sqrt(px * px + py * py + pz * pz)
    u, f = _in_front(radius - rho, law, reach, parameters[8:])
    g = -f / rho if rho > 0.0 else 0.0
    return u, g * px, g * py, g * pz, 0.0


LennardJonesLaw = law_type("LennardJonesLaw", lennard_jones)
HarmonicLaw = law_type("HarmonicLaw", harmonic)
MorseLaw = law_type("MorseLaw", morse)
FENELaw = law_type("FENELaw", fene)
LennardJones93Law = law_type("LennardJones93Law", lennard_jones_93)
MieLaw = law_type("MieLaw", mie)
SoftRepulsionLaw = law_type("SoftRepulsionLaw", soft_repulsion)
QuarticLaw = law_type("QuarticLaw", quartic)
Scaled = law_type("Scaled", scaled)
PeriodicLaw = law_type("PeriodicLaw", periodic)
HarmonicTorsionLaw = law_type("HarmonicTorsionLaw", harmonic_torsion)
RyckaertBellemansLaw = law_type("RyckaertBellemansLaw", ryckaert_bellemans)
DihedralMapLaw = law_type("DihedralMapLaw", dihedral_map)
ConstantLaw = law_type("ConstantLaw", constant)
RestraintLaw = law_type("RestraintLaw", restraint)
Planar = law_type("Planar", planar)
Curved = law_type("Curved", curved)
