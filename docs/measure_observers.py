"""What observers cost: CPU time of a step of the melt without them and with each, interleaved; the correlator alone.

python docs/measure_observers.py [N_ROUNDS]
"""

import socket
import subprocess
import sys
from time import process_time

import numpy as np

import minimd as md
from minimd.observers.correlator import MultipleTau, Product, SquaredDifference

READER = """
import socket, sys, time
while True:
    try:
        reader = socket.create_connection(("localhost", int(sys.argv[1])))
        break
    except ConnectionRefusedError:
        time.sleep(0.01)
reader.sendall(bytes([0, 0, 0, 3, 0, 0, 0, 0]))  # go
while reader.recv(2**20):
    pass
"""
N_STEPS, EDGE = 1000, 10  # steps of a turn; unit cells along an edge: 4000 atoms


def read_stream():
    """A stream that a process of its own reads."""
    with socket.create_server(("localhost", 0)) as free:
        port = free.getsockname()[1]
    subprocess.Popen([sys.executable, "-c", READER, str(port)])
    return [md.observers.Stream(port, wait=True)]


TURNS = {
    "nothing": list,
    "MeanSquareDisplacement(every=10)": lambda: [md.observers.MeanSquareDisplacement()],
    "VelocityAutocorrelation(every=10)": lambda: [md.observers.VelocityAutocorrelation()],
    "Viscosity(every=5)": lambda: [md.observers.Viscosity()],
    "ThermalConductivity(every=5)": lambda: [md.observers.ThermalConductivity(every=5)],
    "SurfaceTension(every=5)": lambda: [md.observers.SurfaceTension(every=5)],
    "PressureProfile(every=50)": lambda: [md.observers.PressureProfile(every=50)],
    "Fluctuations(every=20)": lambda: [md.observers.Fluctuations()],
    "RadialDistribution(every=100), r_max 4.2": lambda: [md.observers.RadialDistribution()],
    "RadialDistribution(r_max=8.4), half the cell": lambda: [md.observers.RadialDistribution(r_max=8.4)],
    "StructureFactor(every=200)": lambda: [md.observers.StructureFactor()],
    "SelfScattering(every=20)": lambda: [md.observers.SelfScattering()],
    "Profile(every=50)": lambda: [md.observers.Profile()],
    "Stream(every=10), nobody reads": lambda: [md.observers.Stream(port=0)],
    "Stream(every=10), read": read_stream,
}


def melt():
    """4000 atoms at T* = 1.44, ρ* = 0.8442, on one thread."""
    positions, edges = md.lattice.crystal("fcc", [EDGE] * 3, md.lattice.constant_from_density("fcc", 0.8442))
    made = md.Simulation(
        md.System(positions, cell=edges), md.LennardJones(1.0, 1.0, 2.5), md.VelocityVerlet(0.002), threads=1
    )
    made.set_temperature(1.44, seed=1)
    made.run(500, every=500, progress=False)
    return made


def correlator_alone(law, n_looks=640):
    """Seconds of CPU for a look."""
    correlator = MultipleTau(law, np.array([0, 4 * EDGE**3]), 3, 16, 10, averages=False)
    sums, entry = np.zeros(correlator.size), np.random.default_rng(1).normal(size=(3, 4 * EDGE**3))
    for _ in range(64):
        correlator.add(entry, sums)
    began = process_time()
    for _ in range(n_looks):
        correlator.add(entry, sums)
    return (process_time() - began) / n_looks


def main(n_rounds):
    """Print a table; medians over rounds."""
    simulation, times = melt(), {name: [] for name in TURNS}
    for one in TURNS.values():
        simulation.run(20, every=20, observers=one(), progress=False)  # compiles
    for _ in range(n_rounds):
        for name, observers in TURNS.items():
            looking = observers()
            if not any(isinstance(one, md.observers.Stream) for one in looking):
                simulation.run(200, every=200, observers=looking, progress=False)  # its first observation makes arrays
            began = process_time()
            simulation.run(N_STEPS, every=N_STEPS, observers=looking, progress=False)
            times[name].append((process_time() - began) / N_STEPS)
    plain = np.median(times["nothing"])
    print(f"{'observers of 4000 atoms':<44} µs a step    of a step without")
    for name, taken in times.items():
        extra = np.median(np.array(taken) - np.array(times["nothing"]))
        print(f"{name:<44} {np.median(taken) * 1e6:9.1f}    {100.0 * extra / plain:+6.1f} %")
    for name, law in (("squared differences", SquaredDifference()), ("products", Product())):
        look = np.median([correlator_alone(law) for _ in range(n_rounds)])
        share = f"{100.0 * look / 10 / plain:.1f} % of a step with a look every 10 steps"
        print(f"correlator alone, {name:<22} {look * 1e6:7.1f} µs a look, {share}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 5)
