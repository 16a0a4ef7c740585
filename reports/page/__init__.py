"""HTML pages, and files for a paper: the report of runs, the site of many, the claim ledger."""
