"""Isolated worker processes, and the services that answer in them."""
