"""The site in headless Chromium: from a disk, on a phone, by keyboard, and small."""

import functools
import shutil
import threading
from collections.abc import Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
from tests.support.browser import WatchedPage
from tests.support.made_runs import note_version

from eitbench.reports.site.site import write_site

pytestmark = pytest.mark.slow

RECORDS = Path(__file__).parents[3] / "reports" / "board"
FIRST_VIEW = 300_000  # bytes before images


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site of records of the leaderboard, under a path of its host."""
    root = tmp_path_factory.mktemp("host")
    for name in ("quick", "imperfect"):
        shutil.copytree(RECORDS / "2026.1" / name, root / "records" / "2026.1" / name)
    shutil.copytree(RECORDS / "2026.2" / "few-presses", root / "records" / "2026.1" / "few-presses")
    note_version(root / "records" / "2026.1")
    return write_site(root / "records", root / "some" / "path").pages[0].parent


@pytest.fixture(scope="module")
def address(site: Path) -> Iterator[str]:
    handler = functools.partial(SimpleHTTPRequestHandler, directory=str(site.parents[1]))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/some/path/"
        server.shutdown()


REPORT = "reports/few-presses/index.html"  # it has figures that are wider than a phone
PAGES = ("index.html", "suites/quick.html", "methods/dnn.html", "data/ohmc16.html", "submit.html")


@pytest.mark.parametrize("name", PAGES)
def test_a_page_works_from_a_disk_and_from_a_host(
    name: str, site: Path, address: str, browser: Any
) -> None:
    for url in ((site / name).as_uri(), address + name):
        opened = WatchedPage(browser, url)
        assert opened.errors == []
        assert all(request.startswith((address, "file:")) for request in opened.requests)
        images = opened.page.locator("img")
        for k in range(images.count()):
            images.nth(k).scroll_into_view_if_needed()
            opened.page.wait_for_function("k => document.images[k].complete", arg=k)
            assert images.nth(k).evaluate("image => image.naturalWidth") > 0
        opened.page.close()


@pytest.mark.parametrize("name", PAGES)
def test_a_page_is_small_and_has_no_faults_of_access(name: str, site: Path, browser: Any) -> None:
    assert len((site / name).read_bytes()) < FIRST_VIEW
    opened = WatchedPage(browser, (site / name).as_uri())
    axe = pytest.importorskip("axe_playwright_python.sync_playwright")
    found = axe.Axe().run(opened.page)
    assert found.violations_count == 0, found.generate_report()
    opened.page.close()


@pytest.mark.parametrize("name", [*PAGES, REPORT])
def test_a_phone_shows_a_page_without_scrolling_sideways(
    name: str, site: Path, browser: Any
) -> None:
    opened = WatchedPage(browser, (site / name).as_uri(), viewport={"width": 360, "height": 740})
    assert opened.page.evaluate("document.documentElement.scrollWidth") <= 360
    opened.page.close()


def test_the_keyboard_leads_to_a_suite_and_back(site: Path, browser: Any) -> None:
    opened = WatchedPage(browser, (site / "index.html").as_uri())
    page = opened.page
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.textContent") == "To the content"
    tabs = page.locator("nav.tabs a")
    assert tabs.all_inner_texts() == ["Overall", "few-presses", "imperfect", "quick"]
    tabs.nth(3).focus()
    page.keyboard.press("Enter")
    page.wait_for_url("**/suites/quick.html")
    assert page.locator("nav.tabs [aria-current=page]").inner_text() == "quick"
    page.locator("nav.tabs a").first.focus()
    page.keyboard.press("Enter")
    page.wait_for_url("**/index.html")
    page.close()
