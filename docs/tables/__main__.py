"""`python -m docs.tables`: write the tables of all pages anew."""

from docs.tables import filled, pages

for page in pages():
    page.write_text(filled(page.read_text()))
