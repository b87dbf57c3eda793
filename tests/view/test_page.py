"""A page of a run asks nobody for anything, is small, and holds the atoms of the file where they are."""

import html
import json
import re
import shutil
import subprocess
from functools import partial
from importlib.resources import files
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from references import melt_scene
from scenes import LJ
from view_pages import LEVELS, Parts, skewed_chains
from wrong_calls import assert_answered

import minimd as md
from minimd.mdanalysis.universes import universe_of
from minimd.structure.cell import nearest_vectors
from minimd.view import View
from minimd.view.page import ATOMS, bonds_among, chosen_atoms, chosen_frames, motion_of, page, run_story

PAGE = files("minimd.view") / "page"
URL = re.compile(r"https?:|//\w", re.I)
LINKS = ("src", "href", "action", "data", "srcset", "poster", "formaction", "srcdoc")
CALLS = re.compile(r"\bfetch\(|XMLHttpRequest|WebSocket|sendBeacon|import\(|@import|url\(")
PROGRAM = """
const bonds = motion.bonds, start = new Float32Array(3 * bonds.length), end = new Float32Array(3 * bonds.length);
motion.halves(7, motion.positions(7), start, end);
console.log(JSON.stringify([motion.positions(7), start, end].map((array) => Array.from(array))));"""


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    path = tmp_path_factory.mktemp("run") / "chains.h5md"
    skewed_chains().run(600, every=20, trajectory=path)
    story = run_story(path, 200)
    return SimpleNamespace(file=path, story=story, html=page(story), parts=Parts(page(story)))


def stored_positions(path):
    with h5py.File(path) as h5:
        return h5["particles/trajectory/position/value"][:]


def asks_nobody(page):
    """Whether no element names anything outside the page, and the browser is told to refuse it."""
    parts = Parts(page)
    linked = [value for _, name, value in parts.attributes if name in LINKS]
    (policy,) = (text for *of, text in parts.attributes if of == ["meta", "content"] and "-src" in text)
    own = [text for name, text in parts.texts.items() if "NGL=" not in text[:1000] or name.startswith("style")]
    refuses = "default-src 'none'" in policy and not URL.search(policy)
    is_whole = all(value.startswith("data:") for value in linked) and "sourceMappingURL" not in page
    return refuses and is_whole and not any(map(CALLS.search, own))


def test_the_page_asks_nobody_and_texts_of_a_scene_are_shown_and_not_run(run):
    assert asks_nobody(run.html)
    for spoiled in ('<img src="https://a.org/b.png">', "<script>fetch('x')</script>"):
        assert not asks_nobody(run.html.replace("</main>", f"{spoiled}</main>"))
    assert not asks_nobody(run.html.replace("default-src 'none'", "default-src *"))
    made = page(run.story._replace(title='<script>alert("1")</script>', report="</pre><img src=x>"))
    assert html.escape('<script>alert("1")</script>') in made
    assert not re.search("<script>alert|</pre><img", made)


@pytest.mark.parametrize("pbc", [(1, 1, 1), (1, 1, 0)], ids=["bulk", "slab"])
def test_the_counts_are_the_positions_of_the_file(tmp_path, pbc):
    """To half a step of the grid along each lattice vector, and to any vector of the lattice."""
    simulation = skewed_chains(pbc=np.array(pbc, dtype=bool))
    record = simulation.run(100, every=10, trajectory=tmp_path / "a.h5md")
    with universe_of(tmp_path / "a.h5md") as opened:
        shown, cell = motion_of(opened, 200), simulation.system.cell
    differences = np.array([shown.positions(k) for k in range(11)]) - stored_positions(tmp_path / "a.h5md")
    differences = differences @ cell.inverse
    differences -= np.where(cell.pbc, np.rint(differences), 0.0)
    width = np.array(shown.width)[:, None]
    assert (np.abs(differences) <= (0.5 + 0.01) * width / LEVELS).all()  # half a step; a hundredth for float32
    assert np.abs(differences).max() > 0.2 * width.min() / LEVELS
    np.testing.assert_array_equal(shown.contents.record.step[shown.frames], record.step)
    np.testing.assert_array_equal(shown.contents.record.temperature[shown.frames], record.temperature)


def test_the_page_holds_these_counts_and_bonds_join_nearest_images(run):
    motion, parts, system = run.story.motion, run.parts, skewed_chains().system
    np.testing.assert_array_equal(parts.counts, motion.counts)
    assert parts.about["steps"] == list(range(0, 601, 20))
    assert parts.about["temperatures"] == motion.contents.record.temperature.tolist()
    np.testing.assert_allclose(parts.positions()[30], motion.positions(30), atol=1e-12)  # rounding
    assert parts.bonds.tolist() == system.bonds.tolist()
    i, j = parts.bonds.T
    differences = (parts.counts[:, j].astype(int) - parts.counts[:, i]).astype(np.int16)
    lattice = np.array(parts.about["lattice"])
    for frame, positions in zip(differences, stored_positions(run.file), strict=True):
        expected = nearest_vectors(positions, system.cell, system.bonds)
        assert np.abs(frame / LEVELS @ lattice - expected).max() <= 1.01 * np.abs(lattice).sum(axis=0).max() / LEVELS


@pytest.mark.skipif(shutil.which("node") is None, reason="needs node")
def test_the_program_of_the_page_puts_atoms_into_the_cell_and_bonds_beside_them(run, tmp_path):
    parts = run.parts
    about, counts, bonds = map(json.dumps, (parts.about, parts.counts.ravel().tolist(), parts.bonds.ravel().tolist()))
    made = f"const motion = new Motion({about}, Uint16Array.from({counts}), new Uint32Array(12), {bonds});"
    (tmp_path / "a.js").write_text(f"{(PAGE / 'motion.js').read_text(encoding='utf-8')}\n{made}{PROGRAM}")
    answer = subprocess.run(["node", tmp_path / "a.js"], capture_output=True, text=True, check=True)
    positions, start, end = (np.array(numbers).reshape(-1, 3) for numbers in json.loads(answer.stdout))
    system, grid = skewed_chains().system, np.abs(np.array(parts.about["edges"])).sum() / LEVELS
    np.testing.assert_allclose(system.cell.wrapped(positions), positions, atol=1e-5)
    differences = (positions - stored_positions(run.file)[7]) @ np.linalg.inv(system.cell.vectors)
    assert np.abs(differences - np.rint(differences)).max() < grid
    np.testing.assert_array_equal(start, positions[system.bonds.ravel()])
    halves = (end - start).reshape(-1, 2, 3)
    expected = nearest_vectors(stored_positions(run.file)[7], system.cell, system.bonds)[:, None] / [[2.0], [-2.0]]
    np.testing.assert_allclose(halves, expected, atol=grid)


def test_frames_and_atoms_are_thinned_and_bonds_are_those_of_the_system_and_of_lengths_held_fixed():
    assert chosen_frames(301, 200)[[0, -1]].tolist() == [0, 300]
    assert (len(chosen_frames(301, 200)), chosen_frames(3, 200).tolist()) == (200, [0, 1, 2])
    assert chosen_frames(7, 3, latest=True).tolist() == [4, 5, 6]
    some = chosen_atoms(10 * ATOMS, (3, 77))
    assert (len(some), len(chosen_atoms(ATOMS)), {3, 77} <= {*some.tolist()}) == (ATOMS + 2, ATOMS, True)
    pairs = md.DistanceConstraints([[5, 4], [1, 2]], 1.0)
    system = md.System(np.arange(18.0).reshape(6, 3), bonds=[[0, 1], [2, 1]], constraints=[pairs])
    assert bonds_among(np.arange(6), system).tolist() == [[0, 1], [1, 2], [4, 5]]
    assert bonds_among(np.array([0, 1, 4, 5]), system).tolist() == [[0, 1], [2, 3]]


def test_a_view_is_shown_in_a_notebook_and_saved(run, tmp_path):
    seen = View(run.html, run.file, "31 frames of 12 atoms")
    frame = re.fullmatch(r'<iframe title=".*?" style=".*?" srcdoc="([^"]*)"></iframe>', seen._repr_html_(), re.S)
    assert html.unescape(frame[1]) == seen.html
    assert seen.save(tmp_path / "a.html").read_text(encoding="utf-8") == seen.html
    assert_answered(lambda: seen.save(tmp_path / "nowhere" / "a.html"), OSError, "nowhere", "No such file")
    assert seen.save() == run.file.with_suffix(".html")
    for frames in (1, 2.5, "all"):
        assert_answered(partial(md.view, run.file, frames=frames), ValueError, "frames", repr(frames))
    assert_answered(lambda: md.view(skewed_chains().run(0)), ValueError, ".h5md", "trajectory=")
    still = md.Simulation(md.System([[0.0, 0.0, 0.0]]), LJ, md.VelocityVerlet(0.004))
    still = still.run(0, trajectory=[tmp_path / "a.xyz", tmp_path / "a.h5md"])  # one frame, of one atom
    assert Parts(md.view(still).html).counts.shape == (1, 1, 3)


@pytest.mark.filterwarnings("ignore:timestep 0.05 τ is longer than the bond")
@pytest.mark.slow
def test_a_failed_run_shows_its_last_steps_and_marks_the_pair(tmp_path):
    simulation = skewed_chains(timestep=0.05)
    with pytest.raises(md.NonFiniteError) as caught:
        simulation.run(4000, trajectory=tmp_path / "a.h5md", every=100)
    error, found = caught.value, caught.value.crash_report
    made = md.view(error.file, potentials=simulation.potentials, frames=2).html
    parts, pair = Parts(made), (found.pair.first, found.pair.second)
    assert (tuple(parts.about["marked"]), parts.about["names"]) == (pair, [str(atom) for atom in pair])
    assert html.escape(found.cause) in made
    assert parts.about["steps"] == [found.last_good_step - 1, found.last_good_step]  # the last ones, of more
    assert found.first_step < parts.about["steps"][0]
    middle = 0.5 * simulation.system.cell.vectors.sum(axis=0) @ simulation.system.cell.inverse
    np.testing.assert_allclose((parts.counts[-1, pair[0]] / LEVELS - middle + 0.5) % 1.0, 0.5, atol=1.0 / LEVELS)
    difference = (parts.counts[-1, pair[1]].astype(int) - parts.counts[-1, pair[0]]).astype(np.int16) / LEVELS
    assert np.linalg.norm(difference @ np.array(parts.about["lattice"])) == pytest.approx(found.pair.distance, abs=1e-3)
    assert asks_nobody(made)
    two_states = [found.first_step, found.last_good_step]  # all there is without its potentials
    assert Parts(md.view(error.file).html).about["steps"] == two_states


@pytest.mark.slow
def test_the_command_writes_a_page_and_names_it(monkeypatch, told, here):
    opened = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    skewed_chains().run(20, every=10, trajectory="a.h5md")
    assert "a.html: 2 frames of 12 atoms" in told("view", "a.h5md", "--frames", 2, "--open")
    assert "2 of 3 frames are shown." in Path("a.html").read_text(encoding="utf-8")
    assert opened == [Path("a.html").resolve().as_uri()]
    Path("c.toml").write_text(melt_scene(4, 20))
    for arguments, shown in ((["b.h5md"], "'b.h5md'"), (["a.h5md", "--scene", "c.toml"], "did not fail")):
        assert shown in told("view", *arguments, code=2)
