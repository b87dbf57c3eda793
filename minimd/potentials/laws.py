"""The laws u(r), each written once, as a function of r² and its parameters."""

from math import sqrt

from minimd.compiled.kernels import scalar
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
        −u′(r)/r = −k (r − r₀)/r, and −k for r₀ = 0, where two atoms may lie on one spot

    r2 : squared distance, > 0, or ≥ 0 for r₀ = 0 [length²].  k : stiffness [energy/length²].  length : r₀, distance of the minimum [length].
    Returns u [energy], −u′/r [energy/length²].
    """
    r = sqrt(r2)
    stretch = r - length
    return 0.5 * k * stretch * stretch, -k if length == 0.0 else -k * stretch / r


@scalar
def scaled(r2, law, parameters):
    """A law times a constant factor, the first of its parameters [dimensionless]: for pairs a few bonds apart.

    parameters : (factor, *parameters of law).
    """
    u, f = evaluate_law(law, r2, parameters[1:])
    return parameters[0] * u, parameters[0] * f


LennardJonesLaw, HarmonicLaw = law_type("LennardJonesLaw", lennard_jones), law_type("HarmonicLaw", harmonic)
Scaled = law_type("Scaled", scaled)
