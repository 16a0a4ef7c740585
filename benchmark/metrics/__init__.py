"""Metrics of images, contacts and forward operators; their statistics and aggregation."""
