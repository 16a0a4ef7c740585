"""The page of a report in headless Chromium: what it shows, and that it works without a network."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from tests.support.browser import WatchedPage
from tests.support.made_runs import edited_manifest

from eitbench.reports.page.report import write_report

pytestmark = pytest.mark.slow

NASTY = "<img src=x onerror=alert(1)>"


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory, run_builder: Any, dataset_of: Any) -> Path:
    folder = tmp_path_factory.mktemp("report")
    presses = dataset_of("position", 24)
    build = run_builder(folder / "run")
    build.add_scaled(dataset_of("conductivity", 24), {"fair": 0.8, NASTY: 0.2, "good": 0.9}, 0.02)
    build.add(presses, "good", presses.conductivity)
    return write_report([build.write()], folder / "report")[0][0].parent


@pytest.fixture(scope="module")
def several(tmp_path_factory: pytest.TempPathFactory, run_builder: Any, dataset_of: Any) -> Path:
    """Two scenarios of a sensor, and one of another on which the order is another."""
    folder = tmp_path_factory.mktemp("several")
    build = run_builder(folder / "run")
    for k, share in enumerate((0.95, 0.95, 0.3)):
        shares = {"net": share, "fair": 0.8, "slow": 0.6}
        build.add_scaled(dataset_of("conductivity", 12, f"s{k}"), shares, 0.01)
    run = build.write()
    cells = pd.read_parquet(run / "methods.parquet")
    told = {
        name: json.dumps({
            "model": True, "conductivity_range": True, "noise": [], "tuned": {}, "given": [],
            "trained_on": {"train_samples": 10 if name == "net" else 0},
        })
        for name in ("net", "fair", "slow")
    }  # fmt: skip
    cells["prior_knowledge"] = cells["method"].map(told)
    cells["frame_ms_p50"] = cells["method"].map({"net": 1.0, "fair": 2.0, "slow": 50.0})
    cells.to_parquet(run / "methods.parquet")
    with edited_manifest(run) as content:
        for k, data in enumerate(content["data"].values()):
            data["sensor"] = "foam16" if k < 2 else "skin"
    return write_report([run], folder / "report")[0][0].parent


class Page(WatchedPage):
    """An open report."""

    def __init__(self, browser: Any, folder: Path, **options: Any) -> None:
        super().__init__(browser, (folder / "index.html").as_uri(), **options)
        self.page.wait_for_selector("html[data-ready=true]", timeout=30_000)

    def column(self, table: str, number: int) -> list[str]:
        cells = self.page.locator(f"{table} tbody tr :is(td, th):nth-child({number})").all()
        return [cell.inner_text().split("\n")[0] for cell in cells]


@pytest.fixture
def opened(browser: Any, report: Path) -> Iterator[Any]:
    pages: list[Page] = []

    def open_page(folder: Path = report, **options: Any) -> Page:
        pages.append(Page(browser, folder, **options))
        return pages[-1]

    yield open_page
    for page in pages:
        page.page.close()
        assert page.errors == []
        assert all(url.startswith(("file:", "blob:", "data:")) for url in page.requests)


def test_names_are_shown_as_text(opened: Any) -> None:
    found = opened()
    assert set(found.column("#leaderboard", 2)) == {"good", "fair", NASTY}
    assert found.page.locator("img").count() == 0


def test_columns_sort_and_rows_filter(opened: Any) -> None:
    found = opened()
    names = found.column("#leaderboard", 2)
    found.page.get_by_role("button", name="RIE").click()
    assert found.column("#leaderboard", 2) == names  # less is better: the best first
    assert found.page.locator("th[aria-sort=ascending]").inner_text().startswith("RIE")
    found.page.get_by_role("button", name="RIE").click()
    assert found.column("#leaderboard", 2) == names[::-1]
    found.page.fill("#search", "goo")
    assert found.column("#leaderboard", 2) == ["good"]
    found.page.fill("#search", "zzz")
    assert found.column("#leaderboard", 1) == ["Nothing matches."]
    found.page.fill("#search", "")
    found.page.select_option("#part", label="ring")
    assert "ring" in found.page.locator("#leaderboard caption").inner_text()


def test_filters_leave_methods_and_scenarios_out(opened: Any, several: Path) -> None:
    found = opened(several)
    page = found.page
    assert found.column("#overall", 1) == ["fair", "net", "slow"]
    assert found.column("#overall", 2) == ["1.67", "1.67", "2.67"]
    page.check("#untrained")
    for table, number in (("#overall", 1), ("#leaderboard", 2)):
        assert set(found.column(table, number)) - {"net"} == {"fair", "slow"}
    assert page.locator("#mine option").all_inner_texts() == ["fair", "slow"]
    assert found.column("#against", 1) == ["slow"]
    page.check("#fast")
    assert found.column("#leaderboard", 2) == ["fair"]
    assert page.locator("#overall").is_hidden()
    assert "needs two methods" in page.locator("#overall-note").inner_text()
    assert page.locator("#mine option").all_inner_texts() == ["fair"]
    assert found.column("#against", 1) == ["No scenario was tested in common."]
    assert "whatever is filtered" in page.locator("#answer-title").inner_text()
    page.uncheck("#untrained")
    page.select_option("#sensor", "foam16")
    assert found.column("#overall", 2) == ["1.00", "2.00"]
    assert page.locator("#board option").all_inner_texts() == ["bench / s0", "bench / s1"]
    page.select_option("#sensor", "skin")
    assert page.locator("#overall-section").is_hidden()  # of a single scenario
    assert "s2" in page.locator("#leaderboard caption").inner_text()


def test_one_method_is_shown_against_the_rest(opened: Any, several: Path) -> None:
    found = opened(several)
    assert found.column("#against", 1) == ["fair", "slow"]
    assert (found.column("#against", 2), found.column("#against", 4)) == (["2", "2"], ["1", "1"])
    found.page.select_option("#mine", "slow")
    assert found.column("#against", 1) == ["net", "fair"]
    assert (found.column("#against", 2), found.column("#against", 4)) == (["1", "–"], ["2", "3"])
    found.page.locator("#overall a", has_text="fair").click()
    assert found.page.url.endswith("#method-1")


def test_weights_rank_again(opened: Any) -> None:
    found = opened()
    order = found.column("#weighted", 2)
    for name in ("ssim", "cc", "psnr"):
        found.page.locator(f"input[data-weight={name}]").fill("0")
    found.page.locator("input[data-weight=rie]").fill("1")
    figures = [float(text) for text in found.column("#weighted", 3)]
    assert figures == sorted(figures, reverse=True)
    assert all(-1 < figure < 0 for figure in figures)  # minus RIE
    found.page.get_by_role("button", name="Reset").click()
    assert found.column("#weighted", 2) == order


def test_images_are_linked_and_can_be_read(opened: Any) -> None:
    found = opened()
    page = found.page
    page.locator("#leaderboard tbody button", has_text="fair").click()
    assert page.locator("#images .head.chosen").inner_text() == "fair"
    assert page.locator("#leaderboard tr.chosen").count() == 1
    # Three cases: the truth, and three methods with their errors.
    assert page.locator("#images canvas").count() == 3 * (1 + 2 * 3)
    page.select_option("#family", "ring")
    page.get_by_role("button", name="truth, ring best case").click()
    canvas = page.locator("#zoom-canvas")
    box = canvas.bounding_box()
    page.mouse.move(box["x"] + 3, box["y"] + 3)
    assert page.locator("#zoom-value").inner_text() == "pixel 0, 39: 1.00 S/m"
    page.keyboard.press("Escape")
    page.select_option("#shown", "error")
    page.get_by_role("button", name="good, ring best case, sample").click()
    page.locator("#zoom-canvas").press("ArrowUp")
    assert "pixel 20, 21: error" in page.locator("#zoom-value").inner_text()
    page.mouse.move(box["x"] + 3, box["y"] + 3)
    assert "error" in page.locator("#zoom-value").inner_text()


def test_presses_are_drawn(opened: Any) -> None:
    found = opened()
    assert found.page.locator("#presses-section").is_hidden()
    found.page.select_option("#board", label="bench / position-set")
    found.page.wait_for_selector("#presses svg")
    assert found.page.locator("#families-section").is_hidden()
    assert "24 presses" in found.page.locator("#presses").get_attribute("aria-label")


@pytest.mark.parametrize(
    ("folder", "scheme", "width"),
    [("report", "light", 375), ("report", "dark", 1280), ("several", "dark", 375)],
)
def test_no_serious_violation_of_accessibility(
    opened: Any, request: pytest.FixtureRequest, folder: str, scheme: str, width: int
) -> None:
    axe = pytest.importorskip("axe_playwright_python.sync_playwright")
    shown = request.getfixturevalue(folder)
    found = opened(shown, color_scheme=scheme, viewport={"width": width, "height": 800})
    assert found.page.evaluate("document.documentElement.scrollWidth") == width
    violations = axe.Axe().run(found.page).response["violations"]
    serious = [v for v in violations if v["impact"] in ("serious", "critical")]
    assert [(v["id"], [n["html"] for n in v["nodes"][:3]]) for v in serious] == []


OVERLAPS = """() => {
  const boxes = [...document.querySelectorAll("#frontier text")].filter((text) => text.textContent)
    .map((text) => [text.textContent, text.getBoundingClientRect()]);
  const meet = (a, b) => a.left < b.right - 1 && b.left < a.right - 1
    && a.top < b.bottom - 1 && b.top < a.bottom - 1;
  return boxes.flatMap(([one, a], k) => boxes.slice(k + 1).filter(([, b]) => meet(a, b))
    .map(([other]) => [one, other]));
}"""


@pytest.mark.parametrize("width", [375, 1280])
def test_nothing_overlaps_in_the_plot_of_quality_and_time(opened: Any, width: int) -> None:
    found = opened(viewport={"width": width, "height": 800})
    found.page.wait_for_selector("#frontier .legend")
    legend = found.page.locator("#frontier .legendtext").all_text_contents()
    assert {"fair", "good", "10 frames/s"} <= set(legend)
    assert found.page.evaluate(OVERLAPS) == []
    found.page.emulate_media(media="print")
    bottom, below = found.page.evaluate(
        """[document.querySelector("#frontier svg").getBoundingClientRect().bottom,
        document.querySelector("#frontier").nextElementSibling.getBoundingClientRect().top]"""
    )
    assert bottom <= below


def test_paper_is_light_and_holds_the_whole_table(opened: Any) -> None:
    found = opened(color_scheme="dark")
    found.page.emulate_media(media="print")
    colour = "getComputedStyle(document.body).color"
    assert found.page.evaluate(colour) == "rgb(0, 0, 0)"
    found.page.set_viewport_size({"width": 1047, "height": 718})  # A4 landscape less its margins
    right = "document.querySelector('#leaderboard').getBoundingClientRect().right"
    assert found.page.evaluate(right) <= 1047
    for heading in ("Show only", "What the figures mean"):
        assert found.page.get_by_text(heading, exact=True).is_hidden()
    assert found.page.locator("details:not([open])").first.is_hidden()
    assert found.page.locator("#leaderboard").is_visible()


def test_the_theme_can_be_changed(opened: Any) -> None:
    found = opened(color_scheme="light")
    ground = "getComputedStyle(document.body).backgroundColor"
    light = found.page.evaluate(ground)
    found.page.locator("#theme").click()
    assert found.page.evaluate(ground) != light
    assert found.page.locator("#theme").inner_text() == "Light"
