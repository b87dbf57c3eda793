"""Steps and forces as students write them: right ones, and wrong ones with words that must be said about each."""

import math

import numpy as np

# fmt: off
W = 1.0 / (2.0 - 2.0 ** (1.0 / 3.0))  # of the triple jump

def kicked(first=0.5, drift=1.0, second=0.5, divided=(True, True), is_old=False):
    """Velocity Verlet; or with other weights, kicks that are not divided by the mass, or the old force twice."""
    def step(x, v, force, m, dt):
        f = force(x)
        v = v + first * dt * f / (m[:, None] if divided[0] else 1.0)
        x = x + drift * dt * v
        return x, v + second * dt * (f if is_old else force(x)) / (m[:, None] if divided[1] else 1.0)

    return step

velocity_verlet = kicked()

def then(change):
    """Velocity Verlet, and a change afterwards."""
    return lambda x, v, force, m, dt: change(*velocity_verlet(x, v, force, m, dt), m, dt)

def composed(*weights, manner=0):
    """Kicks and drifts in turns, the first of them a kick, written in one of four manners."""
    def step(x, v, a, dt):
        for k, weight in enumerate(weights):
            if k % 2:
                x = x + weight * dt * v
            else:
                v = v + weight * dt * a(x)
        return x, v

    def momenta(q, p, grad_u, m, h):
        q, v = step(q, p / m[:, None], lambda q: -grad_u(q) / m[:, None], h)
        return q, m[:, None] * v

    return (lambda x, v, force, m, dt: step(x, v, lambda x: force(x) / m[:, None], dt), step, momenta,
            lambda vel, pos, masses, forces, h: step(pos, vel, lambda x: forces(x) / masses, h)[::-1])[manner]

def explicit_euler(x, v, force, m, dt):
    return x + v * dt, v + dt * force(x) / m[:, None]

# right steps, in several shapes
def in_place(pos, vel, masses, compute_forces, timestep):
    vel += 0.5 * timestep * compute_forces(pos) / masses.reshape(-1, 1)
    pos += timestep * vel
    vel += 0.5 * timestep * compute_forces(pos) / masses.reshape(-1, 1)

def with_accelerations(r, v, acceleration, h):
    a = acceleration(r)
    r = r + h * v + h**2 / 2 * a
    return r, v + h / 2 * (a + acceleration(r))

def in_momenta(q, p, grad_u, m, h):
    p = p - h / 2 * grad_u(q)
    q = q + h * p / m[:, None]
    return q, p - h / 2 * grad_u(q)

def handing_on(x, v, F, compute_force, m, dt):
    v = v + dt / 2 * F / m[:, None]
    x = x + dt * v
    F = compute_force(x)
    return x, v + dt / 2 * F / m[:, None], F

def stormer(x, x_old, force, m, dt):
    return 2 * x - x_old + dt**2 * force(x) / m[:, None], x

def one_particle(x, v, f, m, dt):
    v = v + dt / 2 * f(float(x)) / m
    x = x + dt * v
    return math.fsum([x]), v + dt / 2 * f(x) / m

def in_half_steps(x, v_half, acceleration, m, dt):
    v_half = v_half + dt * acceleration(x)
    return x + dt * v_half, v_half

def yoshida(q, v, acceleration, dt):
    for w in (W, 1.0 - 2.0 * W, W):
        v = v + 0.5 * w * dt * acceleration(q)
        q = q + w * dt * v
        v = v + 0.5 * w * dt * acceleration(q)
    return q, v

def nystrom(x, v, a, dt):
    k1 = a(x)
    k2 = a(x + dt / 2 * v + dt**2 / 8 * k1)
    k3 = a(x + dt * v + dt**2 / 2 * k2)
    return x + dt * v + dt**2 / 6 * (k1 + 2 * k2), v + dt / 6 * (k1 + 4 * k2 + k3)

def beeman(x, v, a, a_old, dt, acc):
    x1 = x + v * dt + (4 * a - a_old) * dt**2 / 6
    return x1, v + (2 * acc(x1) + 5 * a - a_old) * dt / 6

RIGHT_STEPS = [velocity_verlet, in_half_steps, in_place, with_accelerations, in_momenta, handing_on, stormer,
               one_particle]

# wrong steps
def aliased(r, v, force, m, dt):
    a = force(r) / m[:, None]
    a_old = a
    r = r + v * dt + 0.5 * a * dt**2
    a[:] = force(r) / m[:, None]
    return r, v + 0.5 * (a_old + a) * dt

def with_push(push):
    """Velocity Verlet in its form of positions, with a wrong second term."""
    def step(x, v, force, m, dt):
        f = force(x) / m[:, None]
        x = x + dt * v + push(dt) * f
        return x, v + dt / 2 * (f + force(x) / m[:, None])

    return step

def runge_kutta(x, v, force, m, dt, third=2):
    """RK4, or with a third stage that uses k1."""
    rate, y = (lambda x, v: np.array([v, force(x) / m[:, None]])), np.array([x, v])
    k = [rate(*y)]
    k.append(rate(*y + dt / 2 * k[0]))
    k.append(rate(*y + dt / 2 * k[third - 1]))
    k.append(rate(*y + dt * k[2]))
    return tuple(y + dt / 6 * (k[0] + 2 * k[1] + 2 * k[2] + k[3]))

def last_atom_forgotten(x, v, force, m, dt):
    moved = velocity_verlet(x, v, force, m, dt)
    return tuple(np.concatenate([new[:-1], old[-1:]]) for new, old in zip(moved, (x, v), strict=True))

def atom_after_atom(x, v, force, m, dt):
    for i in range(len(x)):
        v[i] += dt * force(x)[i] / m[i]
        x[i] += dt * v[i]
    return x, v

def backward_difference(x, x_prev, force, m, dt):
    new = 2 * x - x_prev + dt**2 * force(x) / m[:, None]
    return new, x, (new - x) / dt

def stale(x, v, F, compute_force, m, dt):
    v = v + dt / 2 * F / m[:, None]
    new = x + dt * v
    return new, v + dt / 2 * compute_force(new) / m[:, None], compute_force(x)

def rescaled(x, v, m, dt):
    kinetic = 0.5 * np.sum(m[:, None] * v * v)
    return x, v * np.sqrt(1.5 * len(x) * 0.5 / kinetic)

WRONG_STEPS = {  # those named first are graded always, the others in slow tests
    "kick first": (composed(1.0, 1.0), "kick first"), "aliased": (aliased, "uses the new force twice"),
    "no mass in one half": (kicked(divided=(True, False)), "a part of the kick has a"), "stale": (stale, "old force"),
    "hidden noise": (then(lambda x, v, m, dt: (x, v + 0.01 * np.random.normal(size=v.shape))), "random numbers"),
    "last atom forgotten": (last_atom_forgotten, "atom 4 of 5"),
    "atom after atom": (atom_after_atom, "one after another"),
    "factor close to one": (then(lambda x, v, m, dt: (x, 0.99999 * v)), "multiplied by 0.99999 "),
    "explicit Euler": (explicit_euler, "old velocity"), "drift first": (composed(0.0, 1.0, 1.0), "drift first"),
    "old force twice": (kicked(is_old=True), "uses the old force"),
    "no mass": (kicked(divided=(False, False)), "kick has a wrong"), "half drift": (kicked(drift=0.5), "by 1/2"),
    "whole kicks": (kicked(1.0, 1.0, 1.0), "by 2"), "factor of 5e-6": (kicked(drift=1.000005), "by 1.000005"),
    "no second kick": (composed(0.5, 1.0), "only half of the kick"),
    "no half in positions": (with_push(lambda dt: dt**2), "factor ½ is missing"),
    "dt in place of its square": (with_push(lambda dt: 0.5 * dt), "needs dt²"),
    "wrong sign": (kicked(-0.5, 1.0, -0.5), "wrong sign"),
    "Runge-Kutta": (lambda x, v, force, m, dt: runge_kutta(x, v, force, m, dt), "not symplectic"),
    "hidden friction": (then(lambda x, v, m, dt: (x, v * (1 - 0.02 * dt))), "friction"),
    "rescaled": (then(rescaled), "thermostat"),
    "wrapped": (then(lambda x, v, m, dt: (x % 10.0, v)), "wrapped into a box"),
    "single precision": (then(lambda x, v, m, dt: (np.float32(x), np.float32(v))), "float32"),
    "backward difference": (backward_difference, "half"),
    "no dt in the kick": (lambda x, v, force, m, dt: (x + dt * (new := v + force(x) / m[:, None]), new), "lacks dt"),
    "recursion without mass": (lambda x, x_old, force, m, dt: (2 * x - x_old + dt**2 * force(x), x), "1/m"),
    "recursion with half": (lambda x, x_old, f, m, dt: (2 * x - x_old + dt**2 / 2 * f(x) / m[:, None], x), "half"),
}
N_QUICK = 4

# forces
def lennard_jones(x, box=None, cutoff=2.5, shift=True, image=None):
    """Forces and energy, pair by pair; image : of a separation, by default the nearest in a box."""
    forces, energy = np.zeros_like(x), 0.0
    image = image or (lambda d: d if box is None else d - box * np.round(d / box))
    for i in range(len(x)):
        for j in range(i + 1, len(x)):
            d = image(x[i] - x[j])
            r2 = d @ d
            if r2 < cutoff**2:
                s6 = r2**-3
                f = 24 * (2 * s6 * s6 - s6) / r2 * d
                forces[[i, j]] += f, -f
                energy += 4 * (s6 * s6 - s6) - shift * 4 * (cutoff**-12 - cutoff**-6)
    return forces, energy

def on_each(x, law, itself=1e10):
    """(N, N, 3) the force f(r) d/r on each atom by each; itself : its distance from itself, far away."""
    d = x[:, None] - x
    r = np.sqrt((d * d).sum(axis=2)) + np.eye(len(x)) * itself
    return (law(r) / r)[:, :, None] * d

def pairs(x, law):
    return on_each(x, law).sum(axis=1)

def force_of_distance(r):
    return 48 / r**13 - 24 / r**7

def law_of_minimd(r2, epsilon, sigma):
    s6 = (sigma**2 / r2) ** 3
    return 4 * epsilon * s6 * (s6 - 1), 24 * epsilon * s6 * (2 * s6 - 1) / r2

def repulsion(r):  # of Weeks, Chandler and Andersen
    is_near = r < 2 ** (1 / 6)
    return np.where(is_near, 4 / r**12 - 4 / r**6 + 1, 0.0), np.where(is_near, force_of_distance(r), 0.0)

RIGHT_FORCES = [(lambda x, box=None, cutoff=2.5: lennard_jones(x, box, cutoff), {}), (force_of_distance, {}),
                (law_of_minimd, {}), (repulsion, {}), (lambda x: pairs(x, force_of_distance), {}),
                (lambda x: -3.0 * (len(x) * x - x.sum(axis=0)), {}), (lambda x: (-2.0 * x, float(np.sum(x * x))), {}),
                (lambda pos, box, cutoff: lennard_jones(pos, box, cutoff)[::-1], {"cell": 8.0, "cutoff": 2.5}),
                (lambda ri, rj: (48 / (r := np.linalg.norm(ri - rj)) ** 14 - 24 / r**8) * (ri - rj), {}),
                (lambda distance, strength: strength / distance**2, {"kind": "law"})]

def overwritten(x):
    n = len(x)
    return on_each(x, force_of_distance)[np.arange(n), np.where(np.arange(n) < n - 1, n - 1, n - 2)]  # only the last

def in_a_cube(x, box, cutoff, of_positions=False):
    x = x - box * np.round(x / box) if of_positions else x
    d = x[:, None] - x
    d = d if of_positions else d - box * np.round(d / box)
    r2 = (d * d).sum(axis=2) + np.eye(len(x)) * 1e10
    inside = r2 < cutoff**2 if of_positions else (np.abs(d) < cutoff).all(axis=2)
    return (np.where(inside, 48 / r2**7 - 24 / r2**4, 0.0)[:, :, None] * d).sum(axis=1)

def whole(x, factor=1.0):
    f, u = lennard_jones(x, cutoff=1e3)
    return factor * f, u

def capped(most):
    return lambda r: (min(force_of_distance(r), most), 4.0 / r**12 - 4.0 / r**6)

CUBE = {"cell": 8.0, "cutoff": 2.5}
WRONG_FORCES = {  # (function, options of md.grade, words)
    "sign": (lambda x: whole(x, -1.0), {}, "wrong sign"),
    "half": (lambda x: whole(x, 0.5), {}, "half of"),
    "du/dr times the vector": (lambda x: (whole(x)[1], pairs(x, lambda r: r * force_of_distance(r))), {}, "1/r is mis"),
    "only one atom": (lambda x: (on_each(x, force_of_distance) * np.tri(len(x)).T[:, :, None]).sum(axis=1),
                      {}, "only one of the two atoms"),
    "= for +=": (overwritten, {}, "overwritten"),
    "jump of the energy": (lambda x: lennard_jones(x, shift=False), {}, "energy jumps"),
    "cutoff not applied": (lambda x: lennard_jones(x, cutoff=1e3), {"cutoff": 2.5}, "cutoff 2.5 is not applied"),
    "no minimum image": (lambda x: lennard_jones(x), {"cell": 8.0}, "minimum image is missing"),
    "one direction": (lambda x, box, cutoff: lennard_jones(x, None, cutoff, image=lambda d: d - box * (d > box / 2))[0],
                      {}, "one direction"),
    "cutoff of components": (lambda x, box, cutoff: in_a_cube(x, box, cutoff), CUBE, "acts on the components"),
    "wrapped positions": (lambda x, box, cutoff: in_a_cube(x, box, cutoff, True), CUBE, "differences are not"),
    "with itself": (lambda x: on_each(x, force_of_distance, 0.0).sum(axis=1), {}, "meets itself"),
    "no gradient": (lambda x: pairs(x, force_of_distance) + 0.3 * np.stack([-x[:, 1], x[:, 0], 0 * x[:, 2]], axis=1),
                    {}, "not the gradient of any energy"),
    "capped at 200": (capped(200.0), {}, "capped"),  "capped at 1000": (capped(1000.0), {}, "capped"),
    "capped pairs": (lambda x: pairs(x, lambda r: np.minimum(force_of_distance(r), 1e4)), {}, "capped"),
    "capped distances": (lambda x: pairs(x, lambda r: force_of_distance(np.maximum(r, 0.9))), {}, "capped"),
    "clipped components": (lambda x: np.clip(pairs(x, force_of_distance), -100, 100), {}, "capped"),
    "a component missing": (lambda x: pairs(x, force_of_distance) * [1, 1, 0], {}, "component"),
    "factor 2 in one term": (lambda r: 24 / r**13 - 24 / r**7, {}, "48"),
    "exponent": (lambda r: 48 / r**13 - 24 / r**6, {}, "exponent"),
    "energy's exponents": (lambda r: 48 / r**12 - 24 / r**6, {}, "1/r is missing"),
    "law with du/dr": (lambda r2: (4 * (r2**-6 - r2**-3), 24 * (2 * r2**-6 - r2**-3)), {}, "1/r is missing"),
    "twice": (lambda x: pairs(x, lambda r: 2 * force_of_distance(r)), {}, "twice"),
    "exponent beside the energy": (lambda r: (48 / r**13 - 24 / r**8, 4 / r**12 - 4 / r**6), {}, "24 r^−7"),
    "divided by their number": (lambda x: pairs(x, force_of_distance) / len(x), {}, "divided"),
    "r² beside the cutoff": (lambda x: pairs(x, lambda r: force_of_distance(r) * (r * r < 2.5)), {"cutoff": 2.5}, "r²"),
    "no central force": (lambda rij: force_of_distance(np.linalg.norm(rij)) * rij[::-1], {}, "along r_ij"),
    "last atom": (lambda x: np.append(pairs(x[:-1], force_of_distance), 0 * x[:1], 0) if len(x) > 2
                  else pairs(x, force_of_distance), {}, "last"),
    "same sign": (lambda r: 48 / r**13 + 24 / r**7, {}, "sign"),
}
