"""Which method to put behind a sensor: what is tried, within a time limit, and what is best."""
