"""Cards of data sets for machines: Croissant, as JSON-LD.

Source: Akhtar et al., Croissant: A Metadata Format for ML-Ready Datasets, DEEM 2024; the format's
specification, version 1.0. `mlcroissant`, its own checker, reads them in a test.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import pandas as pd
from pandas.api import types

from eitbench.benchmark.metrics.specs import METRICS
from eitbench.reports.tables.references import RECORDINGS, SELF, entries, entry_field

if TYPE_CHECKING:
    from pathlib import Path

    from eitbench.benchmark.analysis.catalogue import Recording

_TERMS = (
    "citeAs", "column", "equivalentProperty", "extract", "field", "fileObject", "fileProperty",
    "fileSet", "format", "includes", "isLiveDataset", "jsonPath", "key", "md5", "parentField",
    "path", "recordSet", "references", "regex", "repeated", "replace", "samplingRate", "separator",
    "source", "subField", "transform",
)  # fmt: skip
_CONTEXT: dict[str, Any] = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "cr": "http://mlcommons.org/croissant/",
    "dct": "http://purl.org/dc/terms/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "sc": "https://schema.org/",
    "conformsTo": "dct:conformsTo",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "examples": {"@id": "cr:examples", "@type": "@json"},
    **{term: f"cr:{term}" for term in _TERMS},
}
LICENCE = "https://spdx.org/licenses/Apache-2.0.html"
_LICENCES = {"MIT": "https://spdx.org/licenses/MIT.html", "Apache-2.0": LICENCE}


def suite_card(
    name: str,
    title: str,
    description: str,
    version: str,
    date: str,
    table: Path,
    samples: pd.DataFrame,
) -> dict[str, Any]:
    """The card of what a suite's methods reached: a row for each scenario, method and sample.

    Args:
        name, title, description: of the suite.
        version: of the leaderboard, "" for none.
        date: of the run, such as "2026-11-25".
        table: the file that holds `samples`, which lies beside the card.
    """
    fields = [
        {
            "@type": "cr:Field",
            "@id": f"samples/{column}",
            "name": f"samples/{column}",
            "description": METRICS[column].formula if column in METRICS else column,
            "dataType": _data_type(samples[column]),
            "source": {"fileObject": {"@id": table.name}, "extract": {"column": column}},
        }
        for column in samples
    ]
    records = {"@type": "cr:RecordSet", "@id": "samples", "name": "samples", "field": fields}
    content = table.read_bytes()
    file = _file(table.name, table.name, len(content), hashlib.sha256(content).hexdigest())
    return _card(
        f"eitbench-{name}",
        f"{title}. {description} A row for each "
        "scenario, method and test sample: the touch, the figures of the image, its time.",
        LICENCE,
        entries()[SELF],
        date,
        [file],
        version=f"{version}.0" if version else "1.0.0",
        recordSet=[records],
    )


def recording_card(recording: Recording) -> dict[str, Any]:
    """The card of a public recorded set: its files at their public source."""
    source = recording.source
    entry = entries().get(RECORDINGS.get(recording.name, ""), "")
    doi, year = entry_field(entry, "doi"), entry_field(entry, "year")
    return _card(
        recording.name,
        f"{recording.title}. Frames of electrical impedance tomography of a real sensor; the truth "
        f"that is known of each: {recording.truth}.",
        _LICENCES.get(source.licence, source.licence),
        entry or recording.citation,
        f"{year}-01-01" if year else "",
        [_file(file.path, source.url(file), file.bytes, file.sha256) for file in source.files],
        url=f"https://github.com/{source.repository}/tree/{source.commit}",
        version=f"0.0.0+{source.commit[:10]}",
        **({"identifier": f"https://doi.org/{doi}"} if doi else {}),
    )


def _card(
    name: str,
    description: str,
    licence: str,
    citation: str,
    date: str,
    files: Iterable[Mapping[str, Any]],
    **more: Any,
) -> dict[str, Any]:
    return {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "name": name,
        "description": description,
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "license": licence,
        "citeAs": citation,
        **({"datePublished": date} if date else {}),
        "distribution": list(files),
        **more,
    }


def _file(name: str, address: str, size: int, sha256: str) -> dict[str, Any]:
    known = {"parquet": "application/x-parquet", "csv": "text/csv", "txt": "text/plain"}
    return {
        "@type": "cr:FileObject",
        "@id": re.sub(r"\s", "_", name),  # the format knows no spaces there
        "name": name,
        "contentUrl": address,
        "contentSize": f"{size} B",
        "encodingFormat": known.get(name.rpartition(".")[2], "application/octet-stream"),
        "sha256": sha256,
    }


def _data_type(values: pd.Series) -> str:
    if types.is_bool_dtype(values):
        return "sc:Boolean"
    if types.is_integer_dtype(values):
        return "sc:Integer"
    return "sc:Float" if types.is_float_dtype(values) else "sc:Text"
