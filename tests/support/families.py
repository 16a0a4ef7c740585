"""The families of phantoms of the packaged suites, by their names."""

PUBLISHED_FAMILIES = ("circle", "two-circles", "l-shape", "triangle", "rectangle", "ring")
OBJECT_FAMILIES = (
    *("object-disc", "object-small-disc", "object-triangle"),
    *("object-l-shape", "object-ring", "object-rectangle"),
)
TANK_FAMILIES = ("tank-1", "tank-2", "tank-3")
