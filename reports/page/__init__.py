"""HTML pages and files for a paper."""
