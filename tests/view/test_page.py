"""A page of a run asks nobody for anything, is small, has the atoms where the file has them, and works in a browser."""

import base64
import html
import io
import json
import re
import shutil
import subprocess
from functools import partial
from html.parser import HTMLParser
from importlib.resources import files
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from PIL import Image
from references import melt_scene
from scenes import LJ
from wrong_calls import assert_answered

import minimd as md
from minimd.commands import main as cli
from minimd.core.structure.cell import nearest_vectors
from minimd.mdanalysis.universes import universe_of
from minimd.view import View
from minimd.view.page import ATOMS, bonds_among, chosen_atoms, chosen_frames, motion_of, page, run_story

LEVELS = 65536
PAGE = files("minimd.view") / "page"
URL = re.compile(r"https?:|//\w", re.I)
LINKS = ("src", "href", "action", "data", "srcset", "poster", "formaction", "srcdoc")
CALLS = re.compile(r"\bfetch\(|XMLHttpRequest|WebSocket|sendBeacon|import\(|@import|url\(")
PROGRAM = """
const bonds = motion.bonds, start = new Float32Array(3 * bonds.length), end = new Float32Array(3 * bonds.length);
motion.halves(7, motion.positions(7), start, end);
console.log(JSON.stringify([motion.positions(7), start, end].map((array) => Array.from(array))));"""
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
SOFTWARE = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]  # WebGL without a graphics card


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


@pytest.mark.filterwarnings("ignore:timestep 0.05 τ is long")
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


@pytest.fixture(scope="module")
def chromium():
    playwright = pytest.importorskip("playwright.sync_api")
    with playwright.sync_playwright() as driver:
        try:
            started = driver.chromium.launch(executable_path=CHROMIUM, args=SOFTWARE)
        except playwright.Error as error:
            pytest.skip(f"no browser: {error}")
        yield started
        started.close()


@pytest.fixture
def browser(chromium):
    yield lambda **how: chromium.new_context(**how).new_page()
    for window in chromium.contexts:
        window.close()


class Opened:
    """A page in the browser.  requests : addresses that were asked for.  errors : of the console and the program."""

    def __init__(self, browser, file, scheme="light", init="", size=(500, 500)):
        self.page = browser(viewport={"width": size[0], "height": size[1]}, color_scheme=scheme)
        self.requests, self.errors = [], []
        self.page.add_init_script(init or "0")
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.on("console", lambda message: self.errors.append(message.text) if message.type == "error" else None)
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.goto(file.as_uri())
        self.wait("globalThis.minimd && (minimd.scene || !document.getElementById('scene-error').hidden)")

    def wait(self, condition):
        """Until it holds; the policy of the page forbids playwright's own way, which is eval."""
        for _ in range(300):
            if self.page.evaluate(condition):
                return
            self.page.wait_for_timeout(50)
        pytest.fail(f"{condition} does not come true")

    def frame(self):
        return self.page.evaluate("minimd.player.frame")

    def pixels(self):
        self.page.wait_for_timeout(600)
        return self.page.locator("#scene").screenshot()

    def tab_to(self, name):
        for _ in range(60):
            if self.page.evaluate("document.activeElement.id || document.activeElement.tagName") == name:
                return
            self.page.keyboard.press("Tab")
            if self.page.evaluate("document.activeElement !== document.body"):
                assert self.page.evaluate("getComputedStyle(document.activeElement).outlineStyle") == "solid"
        pytest.fail(f"Tab does not reach {name}")


@pytest.fixture
def run_page(run):
    return md.view(run.file).save()


@pytest.fixture(scope="module")
def failed_page(tmp_path_factory):
    folder = tmp_path_factory.mktemp("failed")
    text = melt_scene(3, 4000, f'[output]\ntrajectory = "{folder}/melt.h5md"\nevery = 100\n')
    (folder / "melt.toml").write_text(text.replace("timestep = 0.004", "timestep = 0.06"))
    assert cli.main(["run", f"{folder}/melt.toml", "--quiet"]) == 3
    return md.view(folder / "melt.crash.h5md").save()


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("kind", ["run_page", "failed_page"])
def test_the_page_makes_no_request_and_no_error(browser, request, kind, scheme):
    file = request.getfixturevalue(kind)
    opened = Opened(browser, file, scheme)
    opened.page.click("#play")
    opened.page.wait_for_timeout(1000)
    assert (opened.requests, opened.errors) == ([file.as_uri()], [])
    background = opened.page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert (background == "rgb(255, 255, 255)") == (scheme == "light")


@pytest.mark.slow
def test_a_browser_without_webgl_is_told_and_shows_the_rest(browser, run_page):
    opened = Opened(browser, run_page, init="HTMLCanvasElement.prototype.getContext = () => null")
    visible = [opened.page.is_visible(f"#{name}") for name in ("scene-error", "shown", "picture")]
    assert (visible, opened.errors) == ([True, False, True], [])


@pytest.mark.slow
def test_frames_advance_when_played_and_the_atoms_move_and_are_where_the_file_has_them(browser, run_page):
    opened, cell = Opened(browser, run_page), skewed_chains().system.cell
    before, first = opened.pixels(), opened.frame()
    opened.page.click("#play")
    opened.wait("minimd.player.frame > 5")
    opened.page.click("#play")
    stopped = opened.frame()
    assert (first, opened.pixels() == before, opened.frame()) == (0, False, stopped)
    assert f"frame {stopped + 1} of 31: step {20 * stopped}, t = " in opened.page.inner_text("#time")
    seen = np.array(list(opened.page.evaluate("Array.from(minimd.motion.positions(30))"))).reshape(-1, 3)
    differences = (seen - Parts(run_page.read_text(encoding="utf-8")).positions()[30]) @ cell.inverse
    assert np.abs(differences - np.rint(differences)).max() < 1e-5


@pytest.mark.slow
def test_the_keyboard_works_every_control(browser, run_page):
    opened = Opened(browser, run_page)

    def press(name, key):
        opened.tab_to(name)
        opened.page.keyboard.press(key)

    keys = "forward Enter 1, forward Space 2, back Enter 1, last Enter 30, first Space 0, frame ArrowRight 1"
    for name, key, frame in map(str.split, keys.split(", ")):
        press(name, key)
        assert opened.frame() == int(frame), name
    of_scene = [("scene", key) for key in ("ArrowLeft", "ArrowUp", "+", "Home")]
    for name, key in [("cell", " "), ("bonds", " "), ("size", "ArrowRight"), *of_scene]:
        before = opened.pixels()
        press(name, key)
        assert opened.pixels() != before, (name, key)
    press("larger", "Enter")
    assert opened.page.inner_text("#zoom") == "125 %"
    press("speed", "ArrowDown")
    press("repeat", " ")
    for name in ("last", "back", "play"):
        press(name, "Enter")
    opened.wait("!minimd.player.isPlaying")
    assert opened.frame() == 30


@pytest.mark.slow
def test_the_pair_is_marked_in_the_middle_of_the_scene(browser, failed_page):
    opened = Opened(browser, failed_page)
    assert opened.frame() == opened.page.evaluate("minimd.motion.nFrames") - 1
    before = opened.pixels()
    opened.tab_to("others")
    opened.page.keyboard.press(" ")
    alone = opened.pixels()
    assert alone != before
    image = np.asarray(Image.open(io.BytesIO(alone)).convert("RGB")).astype(int)
    pink = (image[..., 0] > image[..., 1] + 80) & (image[..., 2] > image[..., 1] + 20)
    middle = np.argwhere(pink).mean(axis=0) / pink.shape
    assert pink.sum() > 500
    np.testing.assert_allclose(middle, 0.5, atol=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("along", [0, 2, None], ids=["a", "c", "cube"])
@pytest.mark.parametrize("size", [(390, 844), (1440, 900)], ids=["phone", "desk"])
def test_the_whole_scene_fits_the_screen(browser, tmp_path, along, size):
    """Of a long cell along each direction, and of a large one; and it fills most of the width or the height."""
    edges = np.full(3, 120.0)
    if along is not None:
        edges = np.where(np.arange(3) == along, 40.0, 4.0)
    system = md.System(np.random.default_rng(1).random((20, 3)) * edges, cell=edges)
    nothing = md.LennardJones(1e-12, 1e-3, 0.1, "force-shifted")
    with pytest.warns(UserWarning, match="within the cutoff"):
        md.Simulation(system, nothing, md.VelocityVerlet(0.004)).run(0, trajectory=tmp_path / "a.h5md")
    opened = Opened(browser, md.view(tmp_path / "a.h5md").save(), size=size)
    image = np.asarray(Image.open(io.BytesIO(opened.pixels())).convert("L"))[3:-3, 3:-3]
    places = np.argwhere(image < 230)
    ends = places.min(axis=0), np.array(image.shape) - 1 - places.max(axis=0)
    assert np.min(ends) > 3
    assert (np.ptp(places, axis=0) / image.shape).max() > 0.6
