"""How it is recorded: boards over a serial port, and emulated ones."""
