"""Finding methods: built in, installed (entry points), or given as a file."""

import hashlib
import importlib
import importlib.util
import sys
import warnings
from collections.abc import Callable
from importlib.metadata import entry_points
from pathlib import Path
from typing import TypeVar

from eitbench.methods.method import Method
from eitbench.scenarios.errors import InputError, unknown_name

ENTRY_POINT_GROUP = "eitbench.methods"
BUILT_IN = (
    "back_projection",
    "tikhonov",
    "noser",
    "laplacian",
    "greit",
    "total_variation",
    "gauss_newton",
)

MAX_NAME = 80  # bytes in UTF-8
RESERVED = "truth"  # stands beside the methods in a file of reconstructions
FORBIDDEN = set("/\\,")  # paths inside a run directory, and the separator of --methods a,b

AnyMethod = TypeVar("AnyMethod", bound=type[Method])
_registered: dict[str, type[Method]] = {}


def register(name: str) -> Callable[[AnyMethod], AnyMethod]:
    """Class decorator: make a `Method` known as `name`.

    Raises:
        InputError: a name that cannot be used or belongs to another class; a decorated class that
            is not a `Method`.
    """
    usable = name.isprintable() and not FORBIDDEN & set(name)
    if (
        not (usable and 0 < len(name.encode()) <= MAX_NAME)
        or name.startswith(".")
        or name == RESERVED
    ):
        raise InputError(
            f"{name!r} cannot name a method: use 1 to {MAX_NAME} bytes of printable characters "
            f"without slashes and commas, not {RESERVED!r} and no dot at the start."
        )

    def decorate(cls: AnyMethod) -> AnyMethod:
        if not (isinstance(cls, type) and issubclass(cls, Method)):
            raise InputError(
                f"{name!r} is registered on {cls!r}, which is not a subclass of Method."
            )
        taken = _registered.get(name)
        if taken is not None and (taken.__module__, taken.__qualname__) != (
            cls.__module__,
            cls.__qualname__,
        ):
            raise InputError(
                f"The method name {name!r} is taken by {taken.__module__}: choose another."
            )
        _registered[name] = cls
        return cls

    return decorate


def methods() -> dict[str, type[Method]]:
    """Every method known: built in, installed (entry-point group), loaded from a file."""
    for module in BUILT_IN:
        importlib.import_module(f"eitbench.methods.{module}")
    for point in entry_points(group=ENTRY_POINT_GROUP):
        try:
            loaded = point.load()
        except Exception as error:  # a broken plugin must not take the others down
            warnings.warn(
                f"The installed plugin {point.value!r} does not import: {error}.",
                stacklevel=2,
            )
            continue
        if isinstance(loaded, type) and loaded not in _registered.values():
            register(point.name)(loaded)
    return dict(sorted(_registered.items()))


def create(name: str, **parameters: object) -> Method:
    """The method `name` with the given constructor parameters.

    Raises:
        InputError: an unknown name (the nearest is suggested) or parameters it does not take.
    """
    known = methods()
    if name not in known:
        raise unknown_name("method", name, known)
    try:
        return known[name](**parameters)
    except TypeError as error:
        raise InputError(f"Method {name!r} cannot be made with {parameters}: {error}.") from error


def load_plugin(path: str | Path) -> list[str]:
    """Run the Python file `path` and return the names of the methods that it registers.

    Raises:
        InputError: no such file, not Python, an error while it runs, or no method registered.
    """
    file = Path(path).resolve()
    if file.suffix != ".py" or not file.is_file():
        raise InputError(f"A plugin is a Python file that exists, got {str(path)!r}.")
    # One module per path, so that a file loaded twice is the same plugin.
    module_name = f"eitbench_plugin_{hashlib.sha256(str(file).encode()).hexdigest()[:12]}"
    spec = importlib.util.spec_from_file_location(module_name, file)
    if spec is None or spec.loader is None:
        raise InputError(f"{file.name} cannot be loaded as a Python module.")
    methods()  # first come, first served: a name that is taken must be taken by now
    module = importlib.util.module_from_spec(spec)
    sys.modules[module_name] = module
    try:
        spec.loader.exec_module(module)
    except InputError:
        raise
    except Exception as error:
        raise InputError(
            f"The plugin {file.name} does not run: {type(error).__name__}: {error}."
        ) from error
    names = [name for name, cls in _registered.items() if cls.__module__ == module_name]
    if not names:
        raise InputError(
            f"The plugin {file.name} registers no method: decorate a class with @register."
        )
    return names
