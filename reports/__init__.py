"""Leaderboards, figures and pages, made from stored results."""
