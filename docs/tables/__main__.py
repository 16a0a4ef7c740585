"""`python -m docs.tables`: write the tables and figures of all pages anew."""

import sys

from docs.tables import filled, pages

from eitbench.scenarios.errors import InputError

anew = {}
for page in pages():
    try:
        anew[page] = filled(page.read_text())
    except InputError as error:
        sys.exit(f"{page}: {error}")
for page, text in anew.items():
    page.write_text(text)
