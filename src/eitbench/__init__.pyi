from .methods import Method as Method
from .methods import Operator as Operator
from .methods import Problem as Problem
from .methods import create as create
from .methods import load_plugin as load_plugin
from .methods import operator as operator
from .methods import register as register
from .methods import register_operator as register_operator
from .methods.registry import operators as operators
from .methods.training.torch_data import training_data as training_data
from .notebook import evaluate as evaluate
from .plotting import plot as plot
from .scenarios import Dataset as Dataset
from .scenarios import EitbenchError as EitbenchError
from .scenarios import ForwardModel as ForwardModel
from .scenarios import InputError as InputError
from .scenarios import RecordedScenario as RecordedScenario
from .scenarios import Sensor as Sensor
from .scenarios import SimulatedScenario as SimulatedScenario
from .scenarios import Suite as Suite
from .scenarios import forward_model as forward_model
from .scenarios import load as load
from .scenarios import load_suite as load_suite
from .scenarios import sensor as sensor

__version__: str
