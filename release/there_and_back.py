"""108 atoms go a long way and come back to the last bit: N steps, all velocities reversed, N steps, killed on the way.

    python release/there_and_back.py [STEPS [KILLS]]     10⁸ steps each way and 100 kills if not given: two hours

Each way is a process with a file of its own. It is killed by SIGKILL at random times and goes on from its restart. The
end must have the hash of the start. The drift of the energy is that of all frames of the way there."""

import subprocess
import sys
import tempfile
from hashlib import sha256
from pathlib import Path
from time import monotonic

import numpy as np

import minimd as md

LAW = md.LennardJones(1.0, 1.0, cutoff=2.2, truncation="smooth")
GRID = md.Grid(2.0**-39, 2.0**-44, 2.0**-42)
N_FRAMES, N_TIMED = 1000, 50_000
SHORTEST = 6.0  # s between two kills: a restart is up to five seconds old


def simulation(system):
    """On one grid for all ways: its room is 2000 σ, beyond which no atom diffuses in 10⁸ steps."""
    method = md.VelocityVerlet(0.004)
    return md.Simulation(system, LAW, method, precision="fixed-point", grid=GRID, threads=1)


def start():
    """A liquid at T* = 1, on the points of its grid."""
    edge = md.lattice.constant_from_density("fcc", 0.8442)
    positions, edges = md.lattice.crystal("fcc", [3, 3, 3], edge)
    sim = simulation(md.System(positions, cell=edges))
    sim.set_temperature(2.0, seed=1)
    sim.run(5000, every=5000, progress=False)
    return sim.system


def go(file, n_steps):
    """One way, or the rest of it, in this process."""
    sim = md.Simulation.resume(file, LAW, threads=1)
    every = max(1, n_steps // N_FRAMES)
    sim.run(until_step=n_steps, every=every, trajectory=file, append=True, progress=False)


def make(file, system, n_steps, seconds, n_kills, rng):
    """One way in processes that are killed; the system at its end, the record, and how many were killed."""
    sim = simulation(system)
    sim.run(0, every=1, trajectory=file, progress=False)
    killed = 0
    while True:
        process = subprocess.Popen([sys.executable, __file__, "--go", file, str(n_steps)])
        patience = max(SHORTEST, rng.exponential(seconds / max(1, n_kills))) if killed < n_kills else None
        try:
            if process.wait(patience) != 0:
                raise SystemExit(f"a process ended with exit code {process.returncode}")
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            killed += 1
            continue
        return md.Simulation.resume(file, LAW).system, md.read_record(file), killed


def hash_of(system):
    """Of positions and velocities."""
    return sha256(system.positions.tobytes() + system.velocities.tobytes()).hexdigest()


def main(n_steps, n_kills):
    """Both ways, and what is to be said of them."""
    begun = monotonic()
    first = start()
    timed = simulation(first.copy())
    timed.run(1000, every=1000, progress=False)
    before = monotonic()
    timed.run(N_TIMED, every=N_TIMED, progress=False)
    seconds = (monotonic() - before) / N_TIMED * n_steps
    print(f"{n_steps} steps there and {n_steps} back, some {2.0 * seconds / 60.0:.0f} minutes", flush=True)
    rng = np.random.default_rng()
    with tempfile.TemporaryDirectory() as folder:
        turn, there, n_there = make(f"{folder}/there.h5md", first.copy(), n_steps, seconds, n_kills // 2, rng)
        far = np.abs(turn.positions - first.positions).max()
        turn.velocities *= -1.0
        end, _, n_back = make(f"{folder}/back.h5md", turn, n_steps, seconds, n_kills - n_kills // 2, rng)
    end.velocities *= -1.0
    time, energy = np.asarray(there.time), np.asarray(there.total_energy) / len(first)
    (slope, _), covariance = np.polyfit(time, energy, 1, cov=True)
    print(f"{n_there + n_back} kills; {(monotonic() - begun) / 60.0:.0f} minutes; atoms moved by up to {far:.4g} σ")
    print(f"energy: drift {slope:.1e} ± {covariance[0, 0] ** 0.5:.1e} ε per atom per τ over {time[-1]:.4g} τ;", end=" ")
    print(f"standard deviation {energy.std():.1e} ε per atom")
    print(f"start {hash_of(first)}\nend   {hash_of(end)}")
    if hash_of(first) != hash_of(end):
        raise SystemExit("THE END IS NOT THE START")
    print("the end is the start, to the last bit")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--go"]:
        go(Path(sys.argv[2]), int(sys.argv[3]))
    else:
        main(*(int(float(word)) for word in (sys.argv[1:] + ["1e8", "100"][len(sys.argv) - 1 :])))
