"""Laws of embedded atoms: of a pair φ(r), of the density g(r) that one atom gives another, of the embedding F(ρ).

    u(r2, …)    φ [energy] and −φ′(r)/r [energy/length²], of a squared distance [length²]
    g(r2, …)    g [density] and −g′(r)/r [density/length²], the unit of density is the potential's own
    F(rho, …)   F [energy] and F′(ρ) [energy/density]

The three laws of one potential take the same parameters, of a species or of a pair of them.
"""

from math import exp, sqrt

import numpy as np

from minimd.core.compiled.kernels import by_type, in_kernels, scalar
from minimd.core.compiled.simd import fma, select
from minimd.core.compiled.simd.vector import MAGIC, columns_at
from minimd.core.potentials.law import evaluate_law, law_type
from minimd.core.potentials.splines import cubic, step_at


def parts(parameters):
    """The two halves of a tuple: of the law of a pair, and of that of the density."""
    half = len(parameters) // 2
    return parameters[:half], parameters[half:]


@in_kernels(parts)
def _parts(parameters):
    half = len(parameters) // 2
    return lambda parameters: (parameters[:half], parameters[half:])


@scalar
def embedded(r2, pair, density, parameters):
    """Two embedded atoms that give each other the same density.

        u = φ(r),   f = −φ′(r)/r − (F′ᵢ + F′ⱼ) g′(r)/r

    parameters : (F′ᵢ, F′ⱼ, those of φ, as many of g).
    M. S. Daw, M. I. Baskes, Phys. Rev. B 29, 6443 (1984).
    """
    of_pair, of_density = parts(parameters[2:])
    u, f = evaluate_law(pair, r2, of_pair)
    _, h = evaluate_law(density, r2, of_density)
    return u, f + (parameters[0] + parameters[1]) * h


@by_type
def densities(law, r2, parameters):
    """(gᵢ, gⱼ) that a law of embedded atoms gives atom i and atom j of a pair."""
    if law.instance_class is EmbeddedLaw:

        def equal(law, r2, parameters):
            _, of_density = parts(parameters[2:])
            g, _ = evaluate_law(law.density, r2, of_density)
            return g, g

        return equal

    formula = law.instance_class.densities
    return lambda law, r2, parameters: formula(r2, law.table, parameters)


@scalar
def sutton_chen_pair(r2, epsilon, a, c, n, m):
    """φ(r) = ε (a/r)ⁿ.

    epsilon : ε [energy].
    a : edge of the cubic cell [length].
    c, n, m : c and the powers [dimensionless].
    A. P. Sutton, J. Chen, Philos. Mag. Lett. 61, 139 (1990).
    """
    u = epsilon * (a * a / r2) ** (0.5 * n)
    return u, n * u / r2


@scalar
def sutton_chen_density(r2, epsilon, a, c, n, m):
    """g(r) = (a/r)ᵐ, see sutton_chen_pair."""
    g = (a * a / r2) ** (0.5 * m)
    return g, m * g / r2


@scalar
def sutton_chen_embedding(rho, epsilon, a, c, n, m):
    """F(ρ) = −ε c √ρ, see sutton_chen_pair."""
    return _root(rho, epsilon * c)


@scalar
def _root(rho, strength):
    """F(ρ) = −A √ρ; an atom alone has none, and no slope."""
    if not rho > 0.0:
        return 0.0, 0.0
    root = sqrt(rho)
    return -strength * root, -0.5 * strength / root


@scalar
def finnis_sinclair_pair(r2, strength, d, beta, c, c0, c1, c2):
    """φ(r) = (r − c)² (c₀ + c₁ r + c₂ r²) for r < c, else 0.

    strength : A of the embedding [energy], with d² in the unit of the density.
    d, beta : of the density [length], [dimensionless].
    c : [length].
    c0, c1, c2 : [energy/length²], [energy/length³], [energy/length⁴].
    M. W. Finnis, J. E. Sinclair, Philos. Mag. A 50, 45 (1984); erratum 53, 161 (1986).
    """
    r = sqrt(r2)
    x = select(r < c, r - c, 0.0)
    polynomial = c0 + r * (c1 + r * c2)
    slope = x * (2.0 * polynomial + x * (c1 + 2.0 * c2 * r))
    return x * x * polynomial, -slope / r


@scalar
def finnis_sinclair_density(r2, strength, d, beta, c, c0, c1, c2):
    """g(r) = (r − d)² + β (r − d)³/d for r < d, else 0, see finnis_sinclair_pair [length²]."""
    r = sqrt(r2)
    x = select(r < d, r - d, 0.0)
    return x * x * (1.0 + beta * x / d), -x * (2.0 + 3.0 * beta * x / d) / r


@scalar
def finnis_sinclair_embedding(rho, strength, d, beta, c, c0, c1, c2):
    """F(ρ) = −A √ρ, see finnis_sinclair_pair."""
    return _root(rho, strength)


@scalar
def gupta_pair(r2, a, xi, p, q, length):
    """φ(r) = 2 A exp[−p (r/r₀ − 1)]: A for each of the two atoms.

    a : A [energy].
    xi : ξ [energy].
    p, q : [dimensionless].
    length : r₀ [length].
    R. P. Gupta, Phys. Rev. B 23, 6265 (1981); F. Cleri, V. Rosato, Phys. Rev. B 48, 22 (1993), equations 1 to 3.
    """
    r = sqrt(r2)
    u = 2.0 * a * exp(-p * (r / length - 1.0))
    return u, p * u / (length * r)


@scalar
def gupta_density(r2, a, xi, p, q, length):
    """g(r) = ξ² exp[−2 q (r/r₀ − 1)], see gupta_pair [energy²]."""
    r = sqrt(r2)
    g = xi * xi * exp(-2.0 * q * (r / length - 1.0))
    return g, 2.0 * q * g / (length * r)


@scalar
def gupta_embedding(rho, a, xi, p, q, length):
    """F(ρ) = −√ρ, see gupta_pair."""
    return _root(rho, 1.0)


@scalar
def tabulated(r2, table, parameters):
    """Two embedded atoms that give each other the same density, from a table.

        u = z(r)/r,   f = (z/r − z′)/r² − (F′ᵢ + F′ⱼ) g′(r)/r

    table : Cubics of g and z.
    parameters : (F′ᵢ, F′ⱼ, first row of the pair of species).
    """
    r2, r, x = _within(r2, table)
    place, t = step_at(x, parameters[2])
    g0, g1, g2, g3, z0, z1, z2, z3 = columns_at(table.rows, place)
    _, slope = cubic(t, g0, g1, g2, g3)
    return _of_pair(r2, r, cubic(t, z0, z1, z2, z3), (parameters[0] + parameters[1]) * slope, table)


@scalar
def tabulated_densities(r2, table, parameters):
    """(g, g), see tabulated."""
    _, _, x = _within(r2, table)
    g = _density(x, parameters[2], table)[0]
    return g, g


@scalar
def tabulated_both_ways(r2, table, parameters):
    """Two embedded atoms that give each other different densities, gᵢ at atom i from j, gⱼ at j from i, from a table.

        u = z(r)/r,   f = (z/r − z′)/r² − (F′ᵢ gᵢ′(r) + F′ⱼ gⱼ′(r))/r

    table : Cubics of gᵢ and z.
    parameters : (F′ᵢ, F′ⱼ, first row of the pair of species, of the pair in the other order).
    """
    r2, r, x = _within(r2, table)
    place, t = step_at(x, parameters[2])
    g0, g1, g2, g3, z0, z1, z2, z3 = columns_at(table.rows, place)
    _, first = cubic(t, g0, g1, g2, g3)
    _, second = _density(x, parameters[3], table)
    slopes = parameters[0] * first + parameters[1] * second
    return _of_pair(r2, r, cubic(t, z0, z1, z2, z3), slopes, table)


@scalar
def tabulated_densities_both_ways(r2, table, parameters):
    """(gᵢ, gⱼ), see tabulated_both_ways."""
    _, _, x = _within(r2, table)
    return _density(x, parameters[2], table)[0], _density(x, parameters[3], table)[0]


@scalar
def _within(r2, table):
    """r², r, and r in steps, of a distance, or of the end of a table, where also what is no number ends."""
    end = table.end / table.per_step
    within = select(r2 < end * end, r2, end * end)
    r = sqrt(within)
    return within, r, r * table.per_step


@scalar
def _density(x, row, table):
    """g and g′ [1/step]."""
    place, t = step_at(x, row)
    g0, g1, g2, g3, _, _, _, _ = columns_at(table.rows, place)
    return cubic(t, g0, g1, g2, g3)


@scalar
def _of_pair(r2, r, z, slopes, table):
    """u and f, see tabulated.
    z : z and z′ [1/step].
    slopes : Σ F′ g′ [energy/step]."""
    inverse2 = 1.0 / r2
    u = z[0] * (r * inverse2)
    return u, inverse2 * (u - table.per_step * fma(r, slopes, z[1]))


@scalar
def tabulated_embedding(rho, table, parameters):
    """F(ρ) from a table of Cubics, beyond its last density a straight line, below zero the cubic of the first step.
    parameters : (row,), the first of the function."""
    x = rho * table.per_step
    inside = min(max(x, 0.5), table.end)
    place, t = step_at(inside, parameters[0])
    c = table.rows[np.uintp(place - MAGIC)]
    value, slope = cubic(t + (x - inside), c[0], c[1], c[2], c[3])
    return value, slope * table.per_step


EmbeddedLaw = law_type("EmbeddedLaw", embedded)
SuttonChenPair = law_type("SuttonChenPair", sutton_chen_pair)
SuttonChenDensity = law_type("SuttonChenDensity", sutton_chen_density)
SuttonChenEmbedding = law_type("SuttonChenEmbedding", sutton_chen_embedding)
FinnisSinclairPair = law_type("FinnisSinclairPair", finnis_sinclair_pair)
FinnisSinclairDensity = law_type("FinnisSinclairDensity", finnis_sinclair_density)
FinnisSinclairEmbedding = law_type("FinnisSinclairEmbedding", finnis_sinclair_embedding)
GuptaPair = law_type("GuptaPair", gupta_pair)
GuptaDensity = law_type("GuptaDensity", gupta_density)
GuptaEmbedding = law_type("GuptaEmbedding", gupta_embedding)
TabulatedEmbedded = law_type("TabulatedEmbedded", tabulated)
TabulatedEmbedded.densities = tabulated_densities
TabulatedBothWays = law_type("TabulatedBothWays", tabulated_both_ways)
TabulatedBothWays.densities = tabulated_densities_both_ways
TabulatedEmbedding = law_type("TabulatedEmbedding", tabulated_embedding)
