"""The live view of a board: a page in the browser with images, contacts and voltages."""
