"""BibTeX of eitbench and of the methods, by the keys that tables cite."""

import re
from collections.abc import Iterable
from importlib.resources import files

KEYS = {
    "back-projection": "kotre1989",
    "coarse-to-fine": "hamilton2018",
    "dip": "liu2023",
    "dnn": "phydnn",
    "eidors-greit": "adler2006",
    "eidors-noser": "adler2006",
    "eidors-tv-pdipm": "adler2006",
    "gauss-newton-noser": "yorkey1987",
    "gauss-newton-tv": "borsic2010",
    "greit": "adler2009",
    "laplacian": "polydorides2002",
    "learned-gn": "adler2017",
    "linear-learned": "hoerl1970",
    "linear-touch": "hoerl1970",
    "noser": "cheney1990",
    "phydnn": "phydnn",
    "pyeit-bp": "liu2018",
    "pyeit-greit": "liu2018",
    "pyeit-jac": "liu2018",
    "tikhonov": "vauhkonen1998",
    "tv": "borsic2010",
}
"""The entry of each method of ours."""

SELF = "eitbench"


def bibliography(methods: Iterable[str]) -> str:
    """BibTeX of eitbench and of what the given methods come from; a comment where none is known."""
    names = sorted(set(methods))
    known = entries()
    keys = dict.fromkeys([SELF, *(KEYS[name] for name in names if name in KEYS)])
    # BibTeX knows no comments: wherever an @ stands, an entry or a command begins.
    unknown = [name.encode("unicode_escape").decode() for name in names if name not in KEYS]
    lines = [name.replace("@", r"\x40") for name in unknown]
    parts = [f"% {line}: no reference is known here." for line in lines]
    return "\n\n".join([*parts, *(known[key] for key in keys)]) + "\n"


def entries() -> dict[str, str]:
    """All entries by key."""
    text = files("eitbench.reports.tables").joinpath("references.bib").read_text(encoding="utf-8")
    return {
        match[1]: match[0].strip()
        for match in re.finditer(r"^@\w+\{(\w+),.*?^\}$", text, re.MULTILINE | re.DOTALL)
    }
