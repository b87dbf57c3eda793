"""The laws u(r), each written once, as a function of r² and its parameters."""

from math import exp, log, nan, sqrt

from minimd.compiled.kernels import scalar
from minimd.compiled.simd import select
from minimd.potentials.law import evaluate_law, law_type


@scalar
def lennard_jones(r2, epsilon, sigma):
    """Lennard-Jones 12-6 law.

        u(r)     = 4ε [(σ/r)¹² − (σ/r)⁶]
        −u′(r)/r = 24ε/r² [2(σ/r)¹² − (σ/r)⁶]

    r2 : squared distance, > 0 [length²].  epsilon : depth of the well, at r = 2^(1/6) σ [energy].
    sigma : distance where u = 0 [length].  Returns u [energy], −u′/r [energy/length²].
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

    r2 : squared distance, > 0, or ≥ 0 for r₀ = 0 [length²].  k : stiffness [energy/length²].  length : r₀, at the
    minimum [length].  Returns u [energy], −u′/r [energy/length²].
    """
    r = sqrt(r2)
    stretch = r - length
    return 0.5 * k * stretch * stretch, select(length == 0.0, -k, -k * stretch / r)


@scalar
def morse(r2, depth, a, length):
    """Morse bond.

        u(r)     = D (1 − x)²,  x = exp[−a (r − r₀)]
        −u′(r)/r = −2 a D (1 − x) x / r

    r2 : squared distance, > 0 [length²].  depth : D, energy that breaks the bond [energy].  a : its width [1/length];
    the stiffness at rest is 2 a² D.  length : r₀, distance of the minimum [length].  Returns u [energy], −u′/r
    [energy/length²].  P. M. Morse, Phys. Rev. 34, 57 (1929).
    """
    r = sqrt(r2)
    x = exp(-a * (r - length))
    return depth * (1.0 - x) * (1.0 - x), -2.0 * a * depth * (1.0 - x) * x / r


@scalar
def fene(r2, k, longest, epsilon, sigma):
    """Finitely extensible bond with the repulsion of its beads.

        u(r)     = −½ k R² ln(1 − (r/R)²) + [4ε ((σ/r)¹² − (σ/r)⁶) + ε below r = 2^(1/6) σ]
        −u′(r)/r = −k / (1 − (r/R)²)      + [24ε/r² (2(σ/r)¹² − (σ/r)⁶)          likewise]

    r2 : squared distance, > 0 [length²].  k : stiffness [energy/length²].  longest : R, which the bond cannot reach
    [length].  epsilon, sigma : ε [energy] and σ [length] of the repulsion.  Returns u [energy], −u′/r [energy/length²];
    NaN from R on.  K. Kremer, G. S. Grest, J. Chem. Phys. 92, 5057 (1990).
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

    r2 : squared distance, > 0 [length²].  epsilon : ε; the well is √10/3 ε deep, at r = (2/5)^(1/6) σ [energy].
    sigma : [length].  Returns u [energy], −u′/r [energy/length²].  W. A. Steele, Surf. Sci. 36, 317 (1973).
    """
    s3 = (sigma * sigma / r2) * sqrt(sigma * sigma / r2)
    s9 = s3 * s3 * s3
    return epsilon * (2.0 / 15.0 * s9 - s3), epsilon / r2 * (1.2 * s9 - 3.0 * s3)


@scalar
def scaled(r2, law, parameters):
    """A law times a constant factor, the first of its parameters [dimensionless]: for pairs a few bonds apart.
    parameters : (factor, *parameters of law)."""
    u, f = evaluate_law(law, r2, parameters[1:])
    return parameters[0] * u, parameters[0] * f


LennardJonesLaw, HarmonicLaw = law_type("LennardJonesLaw", lennard_jones), law_type("HarmonicLaw", harmonic)
MorseLaw, FENELaw = law_type("MorseLaw", morse), law_type("FENELaw", fene)
LennardJones93Law = law_type("LennardJones93Law", lennard_jones_93)
Scaled = law_type("Scaled", scaled)
