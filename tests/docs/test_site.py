"""The built site: its links and references hold, and it asks for nothing outside."""

import re
import subprocess
import sys
from pathlib import Path
from urllib.parse import urlparse

import pytest
from tests.support.browser import WatchedPage

from eitbench.benchmark.metrics.specs import METRICS

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
LOADED = re.compile(
    r"""<(?:(?:script|img|iframe|source)\b[^>]*?\ssrc|link\b[^>]*?\shref)=["']?([^"'\s>]+)"""
)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("material", reason="needs the extra `docs`: run `make docs` before")
    pytest.importorskip("latex2mathml", reason="needs the extra `docs`: run `make docs` before")
    folder = tmp_path_factory.mktemp("site")
    built = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert built.returncode == 0, built.stderr
    return folder


def test_figures_leave_no_marks_and_break_no_sentence(site: Path) -> None:
    for page in site.rglob("*.html"):
        text = page.read_text()
        assert "<!-- figure: " not in text, page
        assert "<!-- end -->" not in text, page
    sentence = r"They saw [\d,]+ samples\sin \d+ epochs"
    assert re.search(sentence, (site / "results" / "learned.html").read_text())


def test_no_page_loads_anything_from_outside(site: Path) -> None:
    pages = list(site.rglob("*.html"))
    assert len(pages) > 20
    for page in pages:
        for address in LOADED.findall(page.read_text()):
            assert not urlparse(address).netloc, f"{page.name} loads {address}"
    for sheet in site.rglob("*.css"):
        for address in re.findall(r"(?:@import|url\()\s*[\"']?([^)\"']+)", sheet.read_text()):
            assert not urlparse(address).netloc, f"{sheet.name} loads {address}"


def test_formulas_are_drawn_and_metrics_are_those_of_the_code(site: Path) -> None:
    assert (site / "explanation/physics.html").read_text().count("<math ") > 40
    for page in site.rglob("*.html"):
        assert 'class="arithmatex"' not in page.read_text(), page
    metrics = (site / "explanation/metrics.html").read_text()
    for name in METRICS:
        assert f'id="{name}"' in metrics
    assert "generated:" not in metrics


def test_every_command_has_its_reference(site: Path) -> None:
    page = (site / "reference/cli.html").read_text()
    for command in ("run", "leaderboard", "recordings-import", "submission-check", "hidden-gap"):
        assert f'id="eitbench-{command}"' in page


@pytest.mark.parametrize("name", ["index", "tutorials/method", "explanation/physics"])
def test_pages_open_from_disk_on_a_telephone(site: Path, browser: object, name: str) -> None:
    view = {"width": 375, "height": 700}
    found = WatchedPage(browser, (site / f"{name}.html").as_uri(), viewport=view)
    assert found.page.evaluate("document.documentElement.scrollWidth") <= 375
    found.page.close()
    assert all(url.startswith(("file:", "data:", "blob:")) for url in found.requests)


def test_pages_that_are_opened_from_disk_can_be_searched(site: Path, browser: object) -> None:
    found = WatchedPage(browser, (site / "explanation/physics.html").as_uri())
    # Pressed keys, because a page that is ready looks at its field only when a key goes up.
    found.page.locator("input[name=query]").press_sequentially("reciprocity")
    result = found.page.locator(".md-search-result__link").first
    result.wait_for(state="attached", timeout=200_000)
    address = str(result.get_attribute("href"))
    assert found.errors == []
    found.page.goto(address)
    assert "reciprocity" in found.page.locator("article").inner_text().lower()
    found.page.close()
    assert all(url.startswith(("file:", "data:", "blob:", "about:")) for url in found.requests)
