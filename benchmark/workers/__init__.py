"""Isolated worker processes, their restart policy, and the services that answer in them."""
