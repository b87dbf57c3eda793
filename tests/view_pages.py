"""Runs to look at, and pages taken apart."""

import base64
import json
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
from references import melt_scene

import minimd as md
from minimd.commands import main as cli

LEVELS = 65536


def skewed_chains(timestep=0.004, pbc=(True, True, True)):
    """Two chains of two species in a cell whose vectors are far from reduced; bonds reach over its faces."""
    k = np.arange(6)
    strand = np.column_stack([4.0 + 0.98 * k, 0.2 * (k % 2), 0.0 * k])
    bonds = np.column_stack([k[:-1], k[1:]])
    positions, bonds = np.concatenate([strand, strand + np.array([0.0, 3.0, 3.0])]), np.concatenate([bonds, bonds + 6])
    cell = [[7.5, 0, 0], [16.0, 6.5, 0], [1.0, 2.0, 7.0]]
    system = md.System(positions, cell=cell, pbc=pbc, species=["A", "B"] * 6, bonds=bonds)
    lj = md.LennardJones(1.0, 1.0, 2.5, "force-shifted", bonded_scale=(0, 1, 1))
    simulation = md.Simulation(system, [lj, md.HarmonicBond(1000.0, 1.0)], md.VelocityVerlet(timestep))
    simulation.set_temperature(0.8, seed=2)
    return simulation


def failed_melt(folder):
    text = melt_scene(3, 4000, f'[output]\ntrajectory = "{folder}/melt.h5md"\nevery = 100\n')
    Path(folder, "melt.toml").write_text(text.replace("timestep = 0.004", "timestep = 0.06"))
    assert cli.main(["run", f"{folder}/melt.toml", "--quiet"]) == 3
    return Path(folder, "melt.crash.h5md")


class Parts(HTMLParser):
    """A page taken apart.  attributes : (element, name, value) of all elements.  texts : of script and style elements,
    by id.  about : what the program knows beside the counts.  counts : (T, N, 3) uint16.  bonds : (B, 2)."""

    def __init__(self, page):
        super().__init__()
        self.attributes, self.texts, self._open = [], {}, None
        self.feed(page)
        self.about = json.loads(self.texts["about"])
        self.counts = self.numbers("counts", "<u2").reshape(len(self.about["steps"]), -1, 3)
        self.bonds = self.numbers("bond-pairs", "<u4").astype(int).reshape(-1, 2)

    def handle_starttag(self, tag, attributes):
        self.attributes += [(tag, name, value) for name, value in attributes]
        if tag in ("script", "style"):
            self._open = dict(attributes).get("id", f"{tag}{len(self.texts)}")
            self.texts[self._open] = ""

    def handle_data(self, data):
        if self._open:
            self.texts[self._open] += data

    def handle_endtag(self, tag):
        if tag in ("script", "style"):
            self._open = None

    def numbers(self, name, kind):
        return np.frombuffer(base64.b64decode(self.texts[name]), dtype=kind)

    def positions(self):
        """(T, N, 3), along the reduced lattice."""
        low, width, lattice = (np.array(self.about[name]) for name in ("low", "width", "lattice"))
        return (low[:, None] + width[:, None] * self.counts / LEVELS) @ lattice
