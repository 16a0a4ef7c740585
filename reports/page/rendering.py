"""Templates and assets of the pages: one environment, in which names and texts are only data."""

import re
from importlib.resources import files
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape
from markupsafe import Markup, escape

from eitbench.reports.tables.columns import printable
from eitbench.reports.tables.formats import escape_markdown

_PACKAGE = "eitbench.reports.page"


def render(template: str, **values: Any) -> str:
    """Return the text of a template; HTML is escaped, and Markdown has the filter `md` for it."""
    environment = Environment(
        loader=PackageLoader(_PACKAGE),
        autoescape=select_autoescape(["html.jinja"]),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "number": _number,
        "code": _code,
        "md": lambda text: escape_markdown(printable(str(text))),
    }
    return environment.get_template(template).render(**values)


def asset(name: str) -> Markup:
    """Return a style sheet or script that lies beside the templates."""
    text = files(_PACKAGE).joinpath("templates", name).read_text(encoding="utf-8")
    return Markup(text)


def _number(value: float | str | None, digits: int = 4) -> str:
    """Return a figure as printed, and words as they are."""
    if value is None:
        return "–"
    return value if isinstance(value, str) else f"{value:.{digits}g}"


def _code(text: str) -> Markup:
    """Return `text` as HTML, with the parts between backticks as code."""
    return Markup(re.sub("`([^`]+)`", r"<code>\1</code>", str(escape(printable(text)))))
