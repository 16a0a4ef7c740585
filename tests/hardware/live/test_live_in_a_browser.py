"""The page of the live view in headless Chromium."""

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.support.browser import WatchedPage

from eitbench.hardware.board import Board
from eitbench.hardware.recording.guided import StepDurations
from eitbench.hardware.registry import make_emulator
from eitbench.methods import Method, register
from eitbench.scenarios.recordings.files.recording_file import read_file
from eitbench.scenarios.recordings.quality import check

pytestmark = pytest.mark.slow

PLACE = (0.03, 0.06)


class Page(WatchedPage):
    """An open live view."""

    def __init__(self, browser: Any, url: str, **options: Any) -> None:
        super().__init__(browser, url, **options)
        self.address = url
        self.wait("document.querySelector('#status').dataset.kind === 'good'")
        self.wait("document.querySelector('#method-shown').textContent !== '–'")

    def wait(self, condition: str) -> None:
        """Poll from here: Playwright's own polling would evaluate strings in the page, which its
        policy forbids."""
        end = time.monotonic() + 20
        while not self.page.evaluate(condition):
            assert time.monotonic() < end, condition
            self.page.wait_for_timeout(30)

    def contact(self) -> tuple[float, float]:
        """Place of the strongest contact on the page [m]; waits for one."""
        self.page.wait_for_selector("#contacts tbody td", timeout=20_000)
        cells = self.page.locator("#contacts tbody tr").first.locator("td").all_inner_texts()
        return float(cells[1]) / 1e3, float(cells[2]) / 1e3

    def pixel(self, x_m: float, y_m: float) -> list[int]:
        """The colour of the image at a place [m]."""
        colour: list[int] = self.page.evaluate(
            "([x, y]) => { const scale = devicePixelRatio; return [...context.getImageData("
            "place.x(x) * scale, place.y(y) * scale, 1, 1).data]; }",
            [x_m, y_m],
        )
        return colour

    def point(self, x_m: float, y_m: float) -> tuple[float, float]:
        """Pixel of a place [m] on the screen."""
        box = self.page.locator("#image").bounding_box()
        x, y = self.page.evaluate("([x, y]) => [place.x(x), place.y(y)]", [x_m, y_m])
        return box["x"] + x, box["y"] + y


@pytest.fixture
def opened(browser: Any, served: Any) -> Iterator[Callable[..., Page]]:
    pages: list[Page] = []

    def open_page(other: Board | None = None, **options: Any) -> Page:
        pages.append(Page(browser, served(other=other).address, **options))
        return pages[-1]

    yield open_page
    for page in pages:
        page.page.close()
        assert page.errors == []
        assert set(page.requests) == {page.address}


def test_images_move_and_their_rate_is_shown(opened: Any, board: Any) -> None:
    page = opened()
    assert page.page.inner_text("#board") == "emulator"
    assert page.page.locator("#emulated").is_visible()
    # How many a second, and how late, is measured in tests/speed/live_rate.py.
    page.wait("Number(document.querySelector('#painted').textContent) > 0")
    assert float(page.page.inner_text("#latency")) > 0
    assert page.page.inner_text("#lost") == "0"
    assert abs(float(page.page.inner_text("#snr")) - 60) <= 1


def test_a_touch_appears_where_it_is_made(opened: Any) -> None:
    page = opened()
    before = page.pixel(*PLACE)
    page.page.mouse.move(*page.point(*PLACE))
    page.page.mouse.down()
    x, y = page.contact()
    assert np.hypot(x - PLACE[0], y - PLACE[1]) < 0.005
    # Beside the marker, which lies over the place itself, and opposite, where nothing is.
    np.testing.assert_allclose(page.pixel(0.08, 0.03), before, atol=15)
    assert np.abs(np.subtract(page.pixel(PLACE[0] - 0.006, PLACE[1]), before)).max() > 40
    page.page.mouse.move(*page.point(0.07, 0.03))
    page.wait("Number(document.querySelector('#contacts td:nth-child(2)').textContent) > 65")
    x, y = page.contact()
    assert np.hypot(x - 0.07, y - 0.03) < 0.005
    page.page.mouse.up()
    page.page.wait_for_selector("#untouched", state="visible")


def test_a_touch_can_be_made_by_keyboard(opened: Any) -> None:
    page = opened()
    page.page.focus("#image")
    for _ in range(10):
        page.page.keyboard.press("ArrowLeft")
    page.page.keyboard.down(" ")
    x, y = page.contact()
    assert np.hypot(x - 0.03, y - 0.05) < 0.005
    page.page.keyboard.up(" ")
    page.page.wait_for_selector("#untouched", state="visible")


def test_a_finger_can_press_without_scrolling(opened: Any) -> None:
    page = opened(viewport={"width": 375, "height": 812}, has_touch=True, device_scale_factor=2)
    session = page.page.context.new_cdp_session(page.page)
    x, y = page.point(*PLACE)
    session.send(
        "Input.dispatchTouchEvent", {"type": "touchStart", "touchPoints": [{"x": x, "y": y}]}
    )
    found = page.contact()
    assert np.hypot(found[0] - PLACE[0], found[1] - PLACE[1]) < 0.005
    session.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    page.page.wait_for_selector("#untouched", state="visible")


def test_the_method_is_switched(opened: Any) -> None:
    page = opened()
    page.page.select_option("#method", "tikhonov")
    page.wait("document.querySelector('#method-shown').textContent === 'tikhonov'")
    page.wait("document.querySelector('#about').textContent.includes('identity')")
    assert page.page.input_value("#method") == "tikhonov"


@register("test-slow")
class Slow(Method):
    """Takes its time: the first image waits, and each of the others for 3 s."""

    go = threading.Event()

    def fit(self, problem: Any) -> None:
        pass

    def reconstruct(self, voltages: Any) -> Any:
        if not self.go.is_set():
            self.go.wait(20)
        else:
            time.sleep(3)
        return np.ones((len(voltages), 80, 80))


def test_a_method_that_is_slower_than_the_board_is_said(opened: Any) -> None:
    page = opened()
    Slow.go.clear()
    page.page.select_option("#method", "test-slow")
    words = "document.querySelector('#status-text').textContent"
    page.wait(f"/^Image of [2-9] s ago: test-slow is slower than the board$/.test({words})")
    # It is fitted, and yet there is no image of it.
    assert page.page.inner_text("#note") == "◌ Preparing test-slow"
    assert page.page.inner_text("#method-shown") == "noser"
    opacity = "getComputedStyle(document.querySelector('#image')).opacity"
    assert float(page.page.evaluate(opacity)) < 0.5
    Slow.go.set()
    page.wait("document.querySelector('#note').textContent === ''")
    assert page.page.inner_text("#method-shown") == "test-slow"
    page.wait(f"/^Image of [2-4] s ago/.test({words})")
    page.page.select_option("#method", "noser")
    page.wait(f"{words} === 'Running'")
    assert page.page.evaluate(opacity) == "1"


def test_what_was_refused_fades_and_hides_no_sentence_of_the_board(opened: Any, board: Any) -> None:
    page = opened()
    page.page.clock.install()
    refuse = "socket.send(JSON.stringify({do: 'method', name: 'nose'}))"
    note = "document.querySelector('#note').textContent"
    page.page.evaluate(refuse)
    page.wait(f"{note}.includes('Unknown method')")
    page.page.clock.fast_forward(11_000)
    page.wait(f"{note} === ''")
    page.page.evaluate(refuse)
    page.wait(f"{note}.includes('Unknown method')")
    board.unplug()
    page.wait(f"{note} === '▲ There is no port.'")
    board.plug()
    page.wait(f"{note}.includes('Unknown method')")
    page.page.get_by_role("button", name="Reset reference").click()
    page.wait(f"{note} === ''")


def test_a_label_covers_neither_ring_nor_marker(opened: Any) -> None:
    page = opened()
    for place in [(0.03, 0.06), (0.08, 0.06), (0.05, 0.05)]:
        page.page.mouse.move(*page.point(*place))
        page.page.mouse.down()
        page.contact()
        label, marker, ring, width = page.page.evaluate(
            "[labels[0],"
            " [place.x(liveImage.contacts[0].x_m), place.y(liveImage.contacts[0].y_m), MARKER],"
            " [place.x(pointer.x), place.y(pointer.y), setup.touch.radius_m * place.perMetre],"
            " place.width]"
        )
        across = label["x"] + np.linspace(0, label["width"], 50)
        down = label["y"] + np.linspace(0, 18, 20)
        x, y = np.meshgrid(across, down)
        assert np.hypot(x - marker[0], y - marker[1]).min() > marker[2]
        distance = np.hypot(x - ring[0], y - ring[1])
        assert distance.min() > ring[2] or distance.max() < ring[2]
        assert 0 <= label["x"] <= width - label["width"]
        page.page.mouse.up()
        page.page.wait_for_selector("#untouched", state="visible")


def test_on_a_phone_recording_needs_no_scrolling(opened: Any) -> None:
    page = opened(viewport={"width": 375, "height": 812})
    for name in ("Reset reference", "Record"):
        box = page.page.get_by_role("button", name=name).bounding_box()
        assert box["y"] + box["height"] < 812


def test_a_recording_made_on_the_page_is_sound_and_whole(
    opened: Any, board: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It begins with a reference, during which the page says so, and holds what was pressed."""
    monkeypatch.setattr(StepDurations, "settle_s", 0.1)
    board.rate_hz = 10.0
    page = opened()
    page.page.get_by_role("button", name="Record").click()
    status = "document.querySelector('#status-text').textContent"
    page.wait(f"{status}.startsWith('Taking the reference: do not touch')")
    page.wait(f"{status} === 'Running'")
    page.wait("document.querySelector('#recording').textContent.startsWith('Recording to ')")
    for x, y in ((0.03, 0.06), (0.07, 0.03)):
        page.page.mouse.move(*page.point(x, y))
        page.page.mouse.down()
        count = len(board.sent)
        while len(board.sent) < count + 6:
            page.page.wait_for_timeout(30)
        page.page.mouse.up()
    page.page.get_by_role("button", name="Stop").click()
    page.wait("document.querySelector('#recording').textContent.startsWith('Recorded')")
    shown = page.page.inner_text("#recording")
    path = Path(shown.removeprefix("Recorded ").split(": ")[0])
    assert check(path)[0] == []
    content, condition = read_file(path)
    assert condition.complete
    assert f": {len(content)} frames" in shown
    np.testing.assert_allclose(
        content.labels[["x_m", "y_m"]], [(0.03, 0.06), (0.07, 0.03)], atol=1e-3
    )
    assert (np.diff(content.number) == 1).all()
    sent = [board.sent[number].values for number in content.number]
    np.testing.assert_array_equal(content.values, sent)


def test_the_reference_is_reset(opened: Any, board: Any) -> None:
    page = opened()
    board.press(*PLACE, 0.008, 20e3)
    page.contact()
    page.page.get_by_role("button", name="Reset reference").click()
    page.page.wait_for_selector("#untouched", state="visible")


def test_an_emulated_board_is_pressed_and_switched_off(opened: Any) -> None:
    """The whole way: emulated sensor, protocol, serial device, server, page."""
    emulator = make_emulator(None, "teensy", None, 2.0)
    page = opened(emulator)
    page.page.mouse.move(*page.point(0.07, 0.03))
    page.page.mouse.down()
    x, y = page.contact()
    assert np.hypot(x - 0.07, y - 0.03) < 0.005
    page.page.mouse.up()
    page.page.wait_for_selector("#untouched", state="visible")
    still = page.page.get_attribute("#image", "data-number")
    emulator.switch_off()
    page.wait("document.querySelector('#status-text').textContent === 'Board lost: trying again'")
    assert page.page.inner_text("#note").startswith("▲ The board on")
    page.wait("document.querySelector('#status-text').textContent === 'Running'")
    page.wait(f"Number(document.querySelector('#image').dataset.number) > {still} + 2")
    assert page.page.inner_text("#note") == ""
    page.wait("Number(document.querySelector('#painted').textContent) > 1")


def test_the_server_goes_away_and_comes_back(opened: Any) -> None:
    page = opened()
    page.page.select_option("#method", "tikhonov")
    page.wait("document.querySelector('#method-shown').textContent === 'tikhonov'")
    page.page.evaluate("socket.close()")
    page.wait("document.querySelector('#status').dataset.kind === 'bad'")
    page.wait("document.querySelector('#status').dataset.kind === 'good'")
    page.wait("document.querySelector('#method').value === 'tikhonov'")
    assert "identity" in page.page.inner_text("#about")


def test_colours_are_fixed_or_fit_the_image(opened: Any, board: Any) -> None:
    page = opened()
    ticks = "[...document.querySelectorAll('#ticks span')].map((tick) => Number(tick.textContent))"
    assert page.page.evaluate(ticks) == pytest.approx([0.2, 0.4, 0.6, 0.8, 1.0])
    page.page.get_by_label("Fit colours to the image").check()
    page.wait(f"{ticks}[0] > 0.9")
    board.press(*PLACE, 0.008, 60e3)
    page.wait(f"{ticks}[0] < 0.7")


@pytest.mark.parametrize(("scheme", "width"), [("light", 375), ("dark", 1280)])
def test_no_serious_violation_of_accessibility(
    opened: Any, board: Any, scheme: str, width: int
) -> None:
    axe = pytest.importorskip("axe_playwright_python.sync_playwright")
    page = opened(color_scheme=scheme, viewport={"width": width, "height": 800})
    board.press(*PLACE, 0.008, 20e3)
    page.contact()
    assert page.page.evaluate("document.documentElement.scrollWidth") == width
    # Axe is put into the page by the test, which its policy forbids to everybody else.
    violations = axe.Axe().run(page.page).response["violations"]
    serious = [v for v in violations if v["impact"] in ("serious", "critical")]
    assert [(v["id"], [n["html"] for n in v["nodes"][:3]]) for v in serious] == []
