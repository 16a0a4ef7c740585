"""Imports and compiled loops that every worker needs, made once in the server of processes.

Imported there, see `process_context`; without it, each worker would spend half a second on it, and
a method's set-up would be timed with it.
"""

import atexit
import gc
import os
import shutil
from contextlib import suppress
from dataclasses import replace

import numpy as np

import eitbench.benchmark.workers.method_service
import eitbench.benchmark.workers.place_service  # noqa: F401
from eitbench.benchmark.workers.process import SOCKETS
from eitbench.methods.registry import METHOD_REGISTRY, PLACE_REGISTRY
from eitbench.scenarios.physics.forward import ForwardModel
from eitbench.scenarios.sensors.sensor import foam16

# The server outlives a run that is killed, which leaves this folder. No worker comes here: it ends
# without a look at `atexit`.
if SOCKETS in os.environ:
    atexit.register(shutil.rmtree, os.environ[SOCKETS], ignore_errors=True)
METHOD_REGISTRY.import_built_in()
PLACE_REGISTRY.import_built_in()
# What fails here fails again where it is needed, with a message.
with suppress(Exception):
    model = ForwardModel(replace(foam16(), image_shape=(16, 16)))
    # These load the compiled loops.
    model.jacobian(model.background)
    for count in (1, 2):
        voltages, fields = model.voltages_and_fields(np.array([model.background] * count))
        model.pullback(fields, voltages)
# Workers need not look through all this for garbage, nor copy its pages because they looked.
gc.collect()
gc.freeze()
