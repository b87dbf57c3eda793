"""Jupiter to Pluto over 20 000 days, 54.8 years: which method is most accurate for its cost, which keeps the energy?

The run starts on 5 September 1994, with the sun and the inner planets as one body (E. Hairer, C. Lubich, G. Wanner,
Geometric Numerical Integration (2006), I.2.4). The final state is known to 6e-15. Units: AU, days, solar masses."""

import matplotlib.pyplot as plt
import numpy as np
from scipy.integrate import solve_ivp

from minimd.integrators import SE1, KahanLi8, SecondOrder, Suzuki4, VelocityVerlet, run_until

G, days = 2.95912208286e-4, 20_000.0
masses = np.array([1.00000597682, 9.54786104043e-4, 2.85583733151e-4, 4.37273164546e-5, 5.17759138449e-5, 1 / 1.3e8])
text = """0 0 0  -3.5023653 -3.8169847 -1.5507963  9.0755314 -3.0458353 -1.6483708  8.310142 -16.2901086 -7.2521278
    11.4707666 -25.7294829 -10.8169456  -15.5387357 -25.2225594 -3.1902382
    0 0 0  0.00565429 -0.0041249 -0.00190589  0.00168318 0.00483525 0.00192462  0.00354178 0.00137102 0.00055029
    0.0028893 0.00114527 0.00039677  0.00276725 -0.00170702 -0.00136504"""
start = np.array(text.split(), dtype=float).reshape(2, 6, 3)  # positions and velocities
jupiter = [-0.771778371878181, 4.610553890044759, 1.994233730131661]  # at the end, from two runs in 80 bits
pluto = [37.285949448705704, -10.728138680006204, -14.554583801118436]


def gravity(q):
    d = q[None] - q[:, None] + np.eye(6)[:, :, None]  # + 1 on the diagonal avoids 0/0
    return G * np.einsum("ij,ijk->ik", masses * (1 - np.eye(6)), d / (d**2).sum(axis=2, keepdims=True) ** 1.5)


def energy(q, v):
    distances = np.linalg.norm(q[:, None] - q[:, :, None] + np.eye(6)[:, :, None], axis=3)
    return 0.5 * (v**2).sum(axis=2) @ masses - 0.5 * G * ((1 - np.eye(6)) / distances @ masses) @ masses


def field(t, y):
    return np.concatenate([y[18:], gravity(y[:18].reshape(6, 3)).ravel()])


def run(method, choice):
    if method == "RK45 of SciPy":
        path = solve_ivp(field, (0, days), np.ravel(start), rtol=choice, atol=choice / 1e3)
        return path.nfev, path.t, *path.y.T.reshape(-1, 2, 6, 3).swapaxes(0, 1)
    path = run_until(SecondOrder(gravity), method(choice), start, days)
    return path.nfev, path.t, path.q, path.v


figure, (orbits, energies, prices) = plt.subplots(1, 3, figsize=(14, 4.5), layout="constrained")
methods = {"RK45 of SciPy": [1e-4, 1e-5, 1e-7, 1e-9], SE1: [100, 40, 10, 5], VelocityVerlet: [200, 50, 20, 5]}
for method, choices in {**methods, Suzuki4: [400, 200, 100, 25], KahanLi8: [1600, 800, 400, 100]}.items():
    paths = [run(method, choice) for choice in choices]
    name = method if isinstance(method, str) else f"{method.name}, order {method.order}"
    errors = [np.abs(q[-1, [1, 5]] - [jupiter, pluto]).max() for _, _, q, _ in paths]
    prices.loglog([nfev for nfev, *_ in paths], errors, "o-", ms=4)
    _, t, q, v = paths[1]
    energies.semilogy(t[1:] / 365.25, np.abs(energy(q, v) / energy(q[:1], v[:1]) - 1)[1:], lw=0.8, label=name)
    print(f"{name:27s} ends within {errors[-1]:.0e} AU of the truth after {paths[-1][0]:4d} forces   (known to 6e-15)")
orbits.plot(*q[:, 1:, :2].transpose(2, 0, 1), lw=1)
orbits.set(title="Jupiter to Pluto, 20 000 days, in AU", aspect="equal")
energies.set(title="energy error, of the second points at the right", xlabel="years", ylim=(1e-8, 10))
prices.set(title="error of Jupiter and Pluto at the end / AU", xlabel="evaluations of the forces")
energies.legend(fontsize=8, loc="upper left")
figure.savefig("outer_solar_system.png", dpi=150)
