"""Draws docs/clusters.png: one domain of a real cluster list, in a layer of atoms seen from the side."""

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

import minimd as md
from minimd.core.compiled.threads import thread_pool
from minimd.core.neighbors import domains
from minimd.core.neighbors.cluster_list import ClusterList
from minimd.core.neighbors.cluster_search import GHOST_BITS, LANES_FROM

CUTOFF, SKIN = 2.5, 0.3
THICKNESS = 8.0**0.5  # at one atom per square, columns are as wide as eight atoms are high
WIDTH, HEIGHT = 8 * THICKNESS, 14.0
HUES = ("#1f5fa8", "#c8501e", "#1b7f5c", "#5b3f99", "#b0872a", "#a8326e")
INK, QUIET = "#222222", "#9a9a9a"


def layer():
    """A liquid of discs in the plane y = 0, periodic along x and z. Two atoms off the plane make it count as thick."""
    x, z = np.meshgrid((np.arange(23) + 0.5) * WIDTH / 23, (np.arange(14) + 0.5) * HEIGHT / 14, indexing="ij")
    positions = np.column_stack([x.ravel(), np.zeros(x.size), z.ravel()])
    system = md.System(positions, cell=[WIDTH, 10.0, HEIGHT], pbc=(True, False, True))
    run = md.Simulation(system, md.LennardJones(1.0, 0.95, 0.95 * 2 ** (1 / 6)), md.VelocityVerlet(0.002))
    run.velocities[:] = np.random.default_rng(4).normal(size=positions.shape) * (1, 0, 1)
    run.run(1500, progress=False)
    run.positions[[0, -1], 1] = -0.5 * THICKNESS, 0.5 * THICKNESS
    return run.system


def cluster_list(system):
    """The list, with two domains although there are so few atoms."""
    domains.ATOMS_PER_DOMAIN = len(system) // 2
    found = ClusterList(len(system), CUTOFF, SKIN, np.zeros((0, 2), dtype=np.int64), False, thread_pool(1))
    found.update(system.positions, system.cell)
    return found


def hue(cluster, found):
    """Colors that differ between neighbors: one column after the other starts elsewhere."""
    column = np.searchsorted(found.clusters.column_start, cluster, side="right") - 1
    return HUES[(cluster - found.clusters.column_start[column] + 2 * column) % len(HUES)]


def draw(panel, system, found):
    """The first domain with its ghosts, and the row of one atom."""
    ghosts, atoms = found.ghosts, found.memory.coordinates.reshape(-1, 3, found.lanes.size)[:, ::2]
    at_home = set(found.ghosts.home[: found.domains.cluster[1]].tolist())
    panel.add_patch(Rectangle((0, 0), WIDTH, HEIGHT, fill=False, ec=INK, lw=1.2))
    inside = system.positions[:, [0, 2]] % (WIDTH, HEIGHT)
    panel.scatter(*inside.T, s=5, c=QUIET, lw=0, zorder=1)
    for ghost in range(found.domains.window[1]):
        n, own = int(ghosts.lanes[ghost]).bit_count(), ghost in at_home
        x, z = atoms[ghost, :, :n]
        color = hue(ghosts.owner[ghost], found)
        panel.scatter(x, z, s=70, c=color, alpha=1.0 if own else 0.28, lw=0, zorder=2)
        low, high = (x.min() - 0.3, z.min() - 0.3), (x.max() + 0.3, z.max() + 0.3)
        size = np.subtract(high, low)
        panel.add_patch(Rectangle(low, *size, fc=color, ec=color, alpha=0.18 if own else 0.07, lw=0, zorder=1.5))
    draw_row(panel, found, atoms)


def draw_row(panel, found, atoms):
    """An atom of the first domain near its upper right corner: its reach, and the lanes in its row."""
    n_lanes = found.lanes.size
    last = found.domains.cluster[1] * n_lanes
    slots = [s for s in range(last) if s % n_lanes < found.clusters.filled[s // n_lanes]]
    corner = (found.domains.column[1] - 0.5) * THICKNESS, HEIGHT - 1.6
    slot = min(slots, key=lambda s: np.hypot(*(atoms[found.ghosts.home[s // n_lanes], :, s % n_lanes] - corner)))
    at = atoms[found.ghosts.home[slot // n_lanes], :, slot % n_lanes]
    rows = found.arrays.rows
    for entry in rows.entries[rows.start[slot] : rows.stops[rows.layers[0] - 1, slot]]:
        ghost, lanes = entry & GHOST_BITS, entry >> LANES_FROM
        counts = [k for k in range(n_lanes) if lanes >> k & 1]
        x, z = atoms[ghost][:, counts]
        panel.scatter(x, z, s=70, fc="none", ec=INK, lw=1.4, zorder=3)
    panel.scatter(*at, s=130, c="#ffd400", ec=INK, lw=1.6, zorder=4)
    panel.add_patch(Circle(at, CUTOFF, fill=False, ec=INK, lw=1.4, zorder=4))
    panel.add_patch(Circle(at, CUTOFF + SKIN, fill=False, ec=INK, lw=1.0, ls=(0, (4, 3)), zorder=4))


def explain(panel, found):
    """Words beside the drawing, with lines to what they mean."""
    edge, far = found.domains.column[1] * THICKNESS, WIDTH + 0.8
    for text, words_at, points_at in (
        ("an atom, its cutoff,\nand cutoff + skin", (far, HEIGHT + 1.6), (edge + 0.55, HEIGHT + 0.1)),
        (
            "ringed: the atoms in its row;\nthose behind have it in theirs",
            (far, HEIGHT - 2.2),
            (edge + 1.95, HEIGHT - 2.2),
        ),
        ("pale: ghosts of clusters of\nthe next domain", (far, 6.4), (edge + THICKNESS + 0.1, 6.0)),
        ("dots: what this domain\ndoes not see", (far, 3.0), (WIDTH - 1.0, 2.6)),
        ("pale: ghosts of clusters at\nthe other end of the cell", (far, -2.4), (edge + THICKNESS + 0.1, -2.0)),
    ):
        panel.annotate(
            text,
            points_at,
            words_at,
            va="center",
            fontsize=9,
            color=INK,
            arrowprops={"arrowstyle": "-", "lw": 0.8, "color": QUIET},
        )
    for x, text in (
        (0.5 * edge, "this domain: clusters of eight in columns"),
        (0.5 * (edge + WIDTH), "the next domain"),
    ):
        panel.text(x, -6.3, text, ha="center", fontsize=9, color=INK)
    panel.annotate(
        "", (0, -5.8), (edge, -5.8), arrowprops={"arrowstyle": "|-|,widthA=0.3,widthB=0.3", "lw": 1.0, "color": INK}
    )
    panel.annotate(
        "", (edge, -5.8), (WIDTH, -5.8), arrowprops={"arrowstyle": "|-|,widthA=0.3,widthB=0.3", "lw": 1.0, "color": INK}
    )
    panel.set(xlim=(-0.6, WIDTH + 8.0), ylim=(-6.8, HEIGHT + 3.8), aspect="equal")
    panel.set_axis_off()


def main():
    """Draw the picture beside this script."""
    system = layer()
    found = cluster_list(system)
    figure = Figure(figsize=(9.6, 7.4), dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    panel = figure.subplots()
    draw(panel, system, found)
    explain(panel, found)
    figure.savefig(Path(__file__).with_name("clusters.png"))


if __name__ == "__main__":
    main()
