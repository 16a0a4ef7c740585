"""How it is recorded: boards over a serial port (nothing here yet)."""
