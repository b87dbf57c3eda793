"""The page in a browser: it makes no request, its frames advance when played, the keyboard reaches every control."""

import io
import shutil

import numpy as np
import pytest
from PIL import Image
from view_pages import Parts, failed_melt, skewed_chains

import minimd as md

pytestmark = pytest.mark.slow
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
SOFTWARE = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]  # WebGL without a graphics card


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

    def __init__(self, browser, file, scheme="light", init=""):
        self.page = browser(viewport={"width": 500, "height": 500}, color_scheme=scheme)
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


@pytest.fixture(scope="module")
def run_page(tmp_path_factory):
    path = tmp_path_factory.mktemp("run") / "chains.h5md"
    skewed_chains().run(600, every=20, trajectory=path)
    return md.view(path).save()


@pytest.fixture(scope="module")
def failed_page(tmp_path_factory):
    return md.view(failed_melt(tmp_path_factory.mktemp("failed"))).save()


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


def test_a_browser_without_webgl_is_told_and_shows_the_rest(browser, run_page):
    opened = Opened(browser, run_page, init="HTMLCanvasElement.prototype.getContext = () => null")
    visible = [opened.page.is_visible(f"#{name}") for name in ("scene-error", "shown", "picture")]
    assert (visible, opened.errors) == ([True, False, True], [])


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
