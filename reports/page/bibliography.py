"""BibTeX of what a report rests on: methods, operators, recordings and suites."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import chain, count
from typing import TYPE_CHECKING, Any

from eitbench.reports.page.report_data import rows_of
from eitbench.reports.tables.formats import escape_latex
from eitbench.reports.tables.references import KEYS, SELF, entries, entry_key, recording_key

if TYPE_CHECKING:
    from eitbench.reports.page.report_data import ReportData


MOST = 4000  # characters of an entry of somebody else
# Accents, letters and signs; another command of an entry could do anything in a paper.
_HARMLESS = re.compile(r"\\(?:[^A-Za-z\s]|(?:aa|AA|ae|AE|oe|OE|ss|[oOlLijcvuHkrbdt])(?![A-Za-z]))")
_ENTRY = re.compile(r"@([A-Za-z]+)\s*\{\s*([\w:.+/-]+)\s*,(.*)\}", re.DOTALL)


def bibliography(report: ReportData) -> str:
    """BibTeX of eitbench and of all that a report rests on; a comment where nothing is known.

    The `source` of a method of somebody else is an entry of BibTeX, or text, with a DOI if it has
    one.
    """
    known = entries()
    found = {SELF: known[SELF]}
    unknown = []
    sources: dict[str, str] = {}
    for run in report["runs"]:
        sources |= run["sources"]
    for row in rows_of(report["boards"]):
        name = str(row.get("operator") or row["method"])
        if name in KEYS:
            found[KEYS[name]] = known[KEYS[name]]
        elif source := sources.get(name, "").strip():
            key, entry = _own_entry(name, source, known | found)
            found[key] = entry
        else:
            unknown.append(name)
    for run in report["runs"]:
        for scenario in run["plan"]["suite"]["scenarios"]:
            if recording := recording_key(run, scenario):
                found[recording] = known[recording]
        found |= _suite_entry(run)
    return "\n\n".join([*_comments(unknown), *found.values()]) + "\n"


def _comments(names: list[str]) -> Iterator[str]:
    """A line for each of the names that nothing is known of."""
    for name in dict.fromkeys(names):
        # BibTeX knows no comments: wherever an @ stands, an entry or a command begins.
        line = name.encode("unicode_escape").decode().replace("@", r"\x40")
        yield f"% {line}: no reference is known here."


def _own_entry(name: str, source: str, taken: dict[str, str]) -> tuple[str, str]:
    """Key and entry of the `source` that somebody gave of the method `name`."""
    entry = _ENTRY.fullmatch(source)
    if entry is not None and _is_harmless(entry[3]):
        kind, own, fields = entry.groups()

        def written(key: str) -> str:
            return f"@{kind}{{{key},{fields}}}"

        # BibTeX takes keys for the same that differ in case alone.
        lower = {known.lower() for known in taken}
        keys = chain((own, f"{own}-own"), (f"{own}-own-{k}" for k in count(2)))
        key = next(k for k in keys if k.lower() not in lower or taken.get(k) == written(k))
        return key, written(key)
    key = entry_key("method", name)
    return key, _misc(key, f"Method {name}", source)


def _is_harmless(fields: str) -> bool:
    """True if the fields of an entry are balanced, end where it ends, and hold no commands."""
    depth, plain = 0, re.sub(r"\\.", "", fields, flags=re.DOTALL)
    for character in plain:
        depth += {"{": 1, "}": -1}.get(character, 0)
        if depth < 0:
            return False
    commands = re.findall(r"\\[^\w\s]|\\\w+|\\", fields)
    allowed = all(_HARMLESS.fullmatch(command) for command in commands)
    return depth == 0 and "@" not in plain and len(fields) <= MOST and allowed


def _misc(key: str, title: str, text: str) -> str:
    """An entry whose note is `text`, with the DOI that it holds."""
    doi = re.search(r"\b10\.\d{4,9}/[^\s,;{}\\]+", text)
    fields = {"key": key, "title": f"{{{_text(title)}}}", "note": _text(text[:MOST])}
    if doi:
        fields["doi"] = doi[0].rstrip(".)")
    return _misc_entry(key, fields)


def _misc_entry(key: str, fields: dict[str, str]) -> str:
    lines = ",\n".join(f"  {name} = {{{value}}}" for name, value in fields.items())
    return f"@misc{{{key},\n{lines}\n}}"


def _text(text: str) -> str:
    """`text` on one line, for LaTeX; BibTeX counts braces, and takes an @ for an entry."""
    plain = " ".join(text.split()).replace("{", "(").replace("}", ")").replace("@", "(at)")
    return escape_latex("".join(c for c in plain if c.isprintable()))


def _suite_entry(run: dict[str, Any]) -> dict[str, str]:
    """The entry of the suite of a run by key: version and data say which one exactly."""
    suite = run["plan"]["suite"]
    key = entry_key("suite", suite["name"])
    version = run["versions"].get("eitbench") or "unknown"
    data = ", ".join(f"{name} {of['hash'][:12]}" for name, of in run["data"].items())
    title = _text(f"Suite {suite['name']} of eitbench: {suite.get('title', '')}")
    fields = {
        "author": "{The eitbench developers}",
        "title": f"{{{title}}}",
        "year": run["started"][:4],
        "note": _text(f"Version {version}; SHA-256 of the data begins with: {data}"),
    }
    return {key: _misc_entry(key, {name: value for name, value in fields.items() if value})}
