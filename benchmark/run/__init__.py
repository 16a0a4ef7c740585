"""From a plan to a finished run: cells, executors, timing, prior knowledge."""
