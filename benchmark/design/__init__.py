"""Design of a sensor: bounds of what it can feel, from its model, before it is built."""
