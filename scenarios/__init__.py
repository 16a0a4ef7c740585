"""What is measured: sensors, drive patterns, forward physics, phantoms, noise, recordings, suites."""
