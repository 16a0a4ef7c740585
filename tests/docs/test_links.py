"""Links that the built site does not check: of pages beside it, and addresses to the outside."""

import re
import urllib.error
import urllib.request
import warnings
from pathlib import Path
from urllib.parse import urlparse

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]
ADDRESSES = {
    address.rstrip(".,;"): page.name
    for page in sorted(PAGES)
    for address in re.findall(r"\bhttps?:[^\s)>\"'`]+", page.read_text())
}


@pytest.mark.parametrize("page", sorted(ROOT.glob("*.md")), ids=lambda page: page.name)
def test_links_of_pages_beside_the_site_lead_somewhere(page: Path) -> None:
    for link in re.findall(r"\]\(([^)\s]+)\)", page.read_text()):
        if not urlparse(link).scheme:
            file, _, anchor = link.partition("#")
            target = ROOT / file if file else page
            assert target.exists(), link
            titles = re.findall(
                r"^#+ (.+)$", target.read_text() if anchor else "", flags=re.MULTILINE
            )
            known = [re.sub(r"[^\w -]", "", title).lower().replace(" ", "-") for title in titles]
            assert not anchor or anchor in known, link


def test_addresses_are_well_formed() -> None:
    for address, page in ADDRESSES.items():
        parts = urlparse(address)
        assert parts.scheme == "https", f"{page}: {address}"
        assert re.fullmatch(r"[\w-]+(\.[\w-]+)+", parts.netloc), f"{page}: {address}"


@pytest.mark.nightly
def test_addresses_can_be_reached() -> None:
    lost, silent = [], []
    for address, page in ADDRESSES.items():
        request = urllib.request.Request(address, headers={"User-Agent": "eitbench link check"})
        try:
            urllib.request.urlopen(request, timeout=20).close()
        except urllib.error.HTTPError as error:
            lost += [f"{page}: {address} ({error.code})"] if error.code in (404, 410) else []
        except OSError as error:
            silent.append(f"{page}: {address} ({error})")
    if len(silent) == len(ADDRESSES):
        pytest.skip(f"no network: {silent[0]}")
    if silent:  # they may answer tomorrow
        warnings.warn(f"no answer: {silent}", stacklevel=1)
    assert not lost


def test_files_of_the_repository_that_pages_name_are_there() -> None:
    for page in PAGES:
        for name in re.findall(r"`([\w./-]+/[\w.-]+\.(?:py|m|toml|json))`", page.read_text()):
            if name.split("/")[0] not in ("runs", "DIR"):
                assert (ROOT / name).exists(), f"{page.name}: {name}"


def test_every_script_of_a_study_is_named_where_its_figures_are() -> None:
    text = "".join(page.read_text() for page in (ROOT / "docs").rglob("*.md"))
    scripts = [
        path.relative_to(ROOT)
        for path in (ROOT / "docs" / "studies").rglob("*.py")
        if "__main__" in path.read_text()
    ]
    assert len(scripts) > 10
    named = [(str(path), ".".join(path.with_suffix("").parts)) for path in scripts]
    assert [path for path, module in named if path not in text and module not in text] == []


def test_every_subpackage_has_its_line_in_contributing() -> None:
    lines = (ROOT / "CONTRIBUTING.md").read_text()
    for folder in ("scenarios", "methods", "benchmark", "hardware", "reports"):
        for face in (ROOT / folder).glob("*/__init__.py"):
            assert f"| `{folder}/{face.parent.name}` |" in lines
