"""Links: those of the site are checked when it is built; here the others, and those to the outside.

That addresses can be reached is tested in the nightly tests only.
"""

import re
import urllib.error
import urllib.request
from pathlib import Path
from urllib.parse import urlparse

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]
ADDRESS = re.compile(r"\bhttps?:[^\s)>\"'`]+")


def addresses() -> dict[str, str]:
    """Every address to the outside, with the page it stands on."""
    return {
        address.rstrip(".,;"): page.name
        for page in sorted(PAGES)
        for address in ADDRESS.findall(page.read_text())
    }


@pytest.mark.parametrize("name", ["README.md", "CONTRIBUTING.md"])
def test_links_of_pages_beside_the_site_lead_somewhere(name: str) -> None:
    text = (ROOT / name).read_text()
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        if urlparse(link).scheme:
            continue
        file, _, anchor = link.partition("#")
        target = ROOT / file if file else ROOT / name
        assert target.exists(), f"{name}: {link}"
        if anchor:
            headings = re.findall(r"^#+ (.+)$", target.read_text(), flags=re.MULTILINE)
            known = [re.sub(r"[^\w -]", "", title).lower().replace(" ", "-") for title in headings]
            assert anchor in known, f"{name}: {link}"


def test_addresses_are_well_formed() -> None:
    for address, page in addresses().items():
        parts = urlparse(address)
        assert parts.scheme == "https", f"{page}: {address}"
        assert re.fullmatch(r"[\w-]+(\.[\w-]+)+", parts.netloc), f"{page}: {address}"


@pytest.mark.slow
def test_addresses_can_be_reached() -> None:
    lost = []
    for address, page in addresses().items():
        request = urllib.request.Request(address, headers={"User-Agent": "eitbench link check"})
        try:
            urllib.request.urlopen(request, timeout=20).close()
        except urllib.error.HTTPError as error:
            lost += [f"{page}: {address} ({error.code})"] if error.code in (404, 410) else []
        except OSError as error:
            pytest.skip(f"no network: {error}")
    assert not lost
