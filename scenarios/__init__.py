"""Everything that is measured: sensors, physics, phantoms, imperfections, recordings, suites."""

import lazy_loader

# The command line must answer before numpy and pandas are loaded; the stub beside has the names.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
