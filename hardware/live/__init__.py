"""The live view: what a board measures, reconstructed as it comes, on a page in the browser."""
