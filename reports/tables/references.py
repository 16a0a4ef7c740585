"""References by key: what methods, operators and recordings come from, and tables cite."""

import re
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

KEYS = {
    "back-projection": "kotre1989",
    "coarse-to-fine": "hamilton2018",
    "cnn-pinn": "raissi2019",
    "dip": "liu2023",
    "dnn": "phydnn",
    "dnn-conformal": "vovk2019",
    "dnn-heteroscedastic": "kendall2017",
    "dnn-large": "phydnn",
    "dnn-randomised": "tobin2017",
    "eidors-greit": "adler2006",
    "eidors-noser": "adler2006",
    "eidors-tv-pdipm": "adler2006",
    "ensemble": "hansen1990",
    "fno": "li2021",
    "gauss-newton-noser": "yorkey1987",
    "gauss-newton-tv": "borsic2010",
    "greit": "adler2009",
    "greit-conformal": "papadopoulos2011",
    "inr": "tancik2020",
    "laplacian": "polydorides2002",
    "latent-flow": "ardizzone2019",
    "learned-gn": "adler2017",
    "learned-gn-2": "adler2017",
    "learned-gn-large": "adler2017",
    "learned-proximal": "adler2018",
    "linear-learned": "hoerl1970",
    "linear-touch": "hoerl1970",
    "network-ensemble": "lakshminarayanan2017",
    "noser": "cheney1990",
    "phydnn": "phydnn",
    "pinn": "raissi2019",
    "pyeit-bp": "liu2018",
    "pyeit-greit": "liu2018",
    "pyeit-jac": "liu2018",
    "shape-posterior": "kolehmainen1999",
    "tank-unet": "denker2024",
    "tikhonov": "vauhkonen1998",
    "tv": "borsic2010",
    "fem": "somersalo1992",
    "jacobian": "geselowitz1971",
    "surrogate": "phydnn",
}
"""The entry of each method and operator of ours."""
RECORDINGS = {
    **dict.fromkeys(
        (
            "ohmc16", "ohmc8", "hydrogel-multitouch", "hydrogel-rectangle", "hydrogel-fixed",
            "hydrogel-repeats", "hydrogel-damage", "hydrogel-two-probes", "superpose500",
            "superpose500-start", "superposed-pairs", "ohmc16-start",
        ),
        "hardman2023",
    ),
    **{f"cam09-{n:02d}": "costacornella2023" for n in (*range(4, 13), 14, 15, 16, 18)},
    **dict.fromkeys(
        ("ktc2023", *(f"ktc2023-level{level}" for level in range(1, 8))), "ktc2023"
    ),
    "superposed-pairs-cam09-05": "costacornella2023",
    "sciospec-tank": "sciospec2025",
    **dict.fromkeys(
        ("jku-tank-adjacent", "jku-tank-diagonal", "jku-tank-hybrid", "jku-tank-opposite"),
        "hofer2024",
    ),
    "pyeidors-tank": "pyeidors2026",
}  # fmt: skip
"""The entry of each public recording."""

SELF = "eitbench"


def reference(method: str) -> str:
    """What a method comes from in words: authors, title, journal and year; "" where unknown."""
    entry = entries().get(KEYS.get(method, ""), "")
    first, *others = entry_field(entry, "author").split(" and ")
    author = f"{first.split(',')[0]} et al." if others else first.split(",")[0]
    where = (entry_field(entry, name) for name in ("title", "journal", "booktitle", "year"))
    return re.sub(r"[{}\\]", "", ", ".join(part for part in (author, *where) if part))


def entry_field(entry: str, name: str) -> str:
    """A field of an entry as it is written there; "" without one."""
    match = re.search(rf"^  {name} = \{{(.*)\}},?$", entry, re.MULTILINE)
    return match[1] if match else ""


def entry_key(kind: str, name: str) -> str:
    """The key of the entry of a suite, or of a method of somebody else."""
    return f"{kind}-{re.sub(r'[^A-Za-z0-9.-]', '-', name)}"


def recording_key(about: Mapping[str, Any], scenario: Mapping[str, Any]) -> str | None:
    """The key of the recording of a declared scenario, if a run has its data and it has a key.

    Args:
        about: the `plan` and `data` of its manifest.
    """
    found = scenario.get("name") in about["data"]
    return RECORDINGS.get(str(scenario.get("recording", ""))) if found else None


def data_keys(about: Mapping[str, Any], name: str) -> str:
    """The keys of the suite of a run and of the recording of the scenario `name`, with commas.

    Args:
        about: the `plan` and `data` of its manifest.
    """
    suite = about["plan"]["suite"]
    recordings = (recording_key(about, s) for s in suite["scenarios"] if s.get("name") == name)
    return ",".join([entry_key("suite", suite["name"]), *filter(None, recordings)])


def entries() -> dict[str, str]:
    """All entries by key."""
    text = files("eitbench.reports.tables").joinpath("references.bib").read_text(encoding="utf-8")
    return {
        match[1]: match[0].strip()
        for match in re.finditer(r"^@\w+\{(\w+),.*?^\}$", text, re.MULTILINE | re.DOTALL)
    }
