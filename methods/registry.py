"""Finding methods and forward operators: built in, installed (entry points), or from a file."""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import inspect
import sys
import warnings
from collections.abc import Callable
from contextlib import redirect_stdout
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

from eitbench.methods.method import Method
from eitbench.methods.operator import Operator
from eitbench.methods.place_method import PlaceMethod
from eitbench.scenarios.errors import InputError, unknown_name
from eitbench.scenarios.extras import missing

if TYPE_CHECKING:
    from eitbench.scenarios.sensors.sensor import Sensor

MAX_NAME = 80  # bytes in UTF-8
RESERVED = ("truth", "ceiling")
"""What stands beside the methods: in a file of reconstructions, and on boards."""
FORBIDDEN = set("/\\,")  # paths inside a run directory, and the separator of --methods a,b

Base = TypeVar("Base", Method, Operator, PlaceMethod)
AnyClass = TypeVar("AnyClass", bound=type)


def usable_name(name: str) -> bool:
    """True if a method or operator may be called `name`."""
    return (
        name.isprintable()  # no lone surrogate is
        and not FORBIDDEN & set(name)
        and 0 < len(name.encode()) <= MAX_NAME
        and not name.startswith(".")
        and name not in RESERVED
    )


@cache
def installed(group: str) -> tuple[EntryPoint, ...]:
    """Members that installed packages offer; packages do not change while a process runs."""
    return tuple(entry_points(group=group))


class Registry(Generic[Base]):
    """Subclasses of `base` by name.

    Attributes:
        kind: what a member is called in messages.
        base: the class that members are made from.
        group: the group of entry points that installed packages offer members in.
        decorator: the name of the function that is its `register`.
        built_in: the modules of eitbench that register members when they are imported.
        needs: the library, of an extra, that these modules need; "" for none.
    """

    def __init__(
        self,
        kind: str,
        base: type[Base],
        group: str,
        decorator: str,
        built_in: tuple[str, ...],
        needs: str = "",
    ) -> None:
        self.kind = kind
        self.base: type[Base] = base
        self.group = group
        self.decorator = decorator
        self.built_in = built_in
        self.needs = needs
        self._registered: dict[str, type[Base]] = {}

    def register(self, name: str) -> Callable[[AnyClass], AnyClass]:
        """Class decorator: make a subclass of `base` known as `name`.

        Raises:
            InputError: a name that cannot be used or belongs to another class, of any registry; a
                decorated class that is no subclass of `base`.
        """
        if not isinstance(name, str):  # the decorator without its parentheses
            raise InputError(f'A {self.kind} needs a name: write @{self.decorator}("my-name").')
        if not usable_name(name):
            raise InputError(
                f"{name!r} cannot name a {self.kind}: use 1 to {MAX_NAME} bytes of printable "
                "characters without slashes and commas, no dot at the start and not "
                f"{' or '.join(map(repr, RESERVED))}."
            )

        def decorate(cls: AnyClass) -> AnyClass:
            if not (isinstance(cls, type) and issubclass(cls, self.base)):
                raise InputError(
                    f"{name!r} is registered on {cls!r}, which is not a subclass of "
                    f"{self.base.__name__}."
                )
            if not cls.__module__.startswith("eitbench.methods."):
                for registry in registries():
                    registry.import_built_in()  # their names are taken before a plugin's
            # Runs and boards know a name alone: it is of one thing, of whatever kind.
            for registry in REGISTRIES:
                taken = registry._registered.get(name)
                if taken is not None and (taken.__module__, taken.__qualname__) != (
                    cls.__module__,
                    cls.__qualname__,
                ):
                    raise InputError(
                        f"The name {name!r} is taken by {taken.__module__} ({registry.kind}): "
                        "choose another."
                    )
            if lacking := sorted(getattr(cls, "__abstractmethods__", ())):
                raise InputError(
                    f"The class {cls.__name__} of {name!r} lacks {' and '.join(lacking)}."
                )
            self._registered[name] = cls
            return cls

        return decorate

    def known(self) -> dict[str, type[Base]]:
        """Every member: built in, installed (entry-point group), loaded from a file."""
        self.import_built_in()
        for point in installed(self.group):
            try:
                with redirect_stdout(sys.stderr):  # standard output may be read by programs
                    loaded = point.load()
            except Exception as error:  # a broken plugin must not take the others down
                warnings.warn(
                    f"The installed plugin {point.value!r} does not import: {error}.",
                    stacklevel=2,
                )
                continue
            if isinstance(loaded, type) and loaded not in self._registered.values():
                self.register(point.name)(loaded)
        return dict(sorted(self._registered.items()))

    def create(self, name: str, *arguments: object, **parameters: object) -> Base:
        """A member made with the given arguments of its constructor.

        Raises:
            InputError: an unknown name (the nearest is suggested) or parameters it does not take.
        """
        known = self.known()
        if name not in known:
            raise unknown_name(self.kind, name, known)
        try:
            make: Callable[..., Base] = known[name]
            return make(*arguments, **parameters)
        except TypeError as error:
            why = f"{error}."
            takes = inspect.signature(known[name]).parameters
            if parameters.keys() - takes.keys():
                why = f"its parameters are {', '.join(takes) or 'none'}."
            raise InputError(
                f"{self.kind.capitalize()} {name!r} cannot be made with {parameters}: {why}"
            ) from error

    def of_module(self, module: str) -> list[str]:
        """The names that the Python module called `module` registered."""
        return [name for name, cls in self._registered.items() if cls.__module__ == module]

    def import_built_in(self) -> None:
        """Import the modules of eitbench that register members."""
        for module in self.built_in:
            importlib.import_module(f"eitbench.methods.{module}")


METHOD_REGISTRY = Registry(
    "method",
    Method,  # type: ignore[type-abstract]
    "eitbench.methods",
    "register",
    (
        "classical.back_projection",
        "classical.tikhonov",
        "classical.noser",
        "classical.laplacian",
        "classical.greit",
        "classical.greit_conformal",
        "classical.total_variation",
        "classical.gauss_newton",
        "learned.linear_maps",
        "learned.image_networks",
        "learned.fourier_operator",
        "learned.learned_proximal",
        "untrained.dip",
        "untrained.inr",
        "untrained.pinn",
        "learned.refined",
        "learned.ensemble",
        "learned.conformal",
        "learned.latent_flow",
        "learned.cnn_pinn",
        "learned.tank_unet",
        "shapes.shape_posterior",
        "peers.pyeit_methods",
        "peers.eidors",
    ),
)
OPERATOR_REGISTRY = Registry(
    "operator",
    Operator,  # type: ignore[type-abstract]
    "eitbench.operators",
    "register_operator",
    ("operators.jacobian", "operators.surrogate", "operators.fem"),
    needs="torch",
)

PLACE_REGISTRY = Registry(
    "place method",
    PlaceMethod,  # type: ignore[type-abstract]
    "eitbench.place_methods",
    "register_place_method",
    ("places.regressions", "places.networks", "places.topographic_map"),
)

REGISTRIES: tuple[Registry[Any], ...] = (METHOD_REGISTRY, OPERATOR_REGISTRY, PLACE_REGISTRY)


def registries() -> list[Registry[Any]]:
    """Those whose built-in members can be imported with the libraries that are installed."""
    return [each for each in REGISTRIES if not (each.needs and missing(each.needs))]


register = METHOD_REGISTRY.register
methods = METHOD_REGISTRY.known
create = METHOD_REGISTRY.create
register_place_method = PLACE_REGISTRY.register
register_operator = OPERATOR_REGISTRY.register
operators = OPERATOR_REGISTRY.known


def operator(name: str, sensor: Sensor) -> Operator:
    """The forward operator `name` of `sensor`.

    Raises:
        InputError: an unknown name (the nearest is suggested).
    """
    return OPERATOR_REGISTRY.create(name, sensor)


def place_methods() -> dict[str, type[Method] | type[PlaceMethod]]:
    """All that can say where a press is: methods of places, and those of images by their images."""
    return {**METHOD_REGISTRY.known(), **PLACE_REGISTRY.known()}


def source_hash(cls: type) -> str:
    """SHA-256 (hex) of the file that somebody else wrote `cls` in; "" for a class of eitbench.

    What is ours changes with its version alone.
    """
    if cls.__module__.startswith("eitbench."):
        return ""
    try:
        content = Path(inspect.getfile(cls)).read_bytes()
    except (OSError, TypeError):  # from a notebook or an archive
        content = cls.__qualname__.encode()
    return hashlib.sha256(content).hexdigest()


class Plugin(NamedTuple):
    """The names that a file registers."""

    methods: list[str]
    operators: list[str]
    places: list[str]


def load_plugin(path: str | Path) -> Plugin:
    """Run the Python file `path` and return the names that it registers.

    Raises:
        InputError: no such file, not Python, an error while it runs, or nothing registered.
    """
    file = Path(path).resolve()
    if file.suffix != ".py" or not file.is_file():
        raise InputError(f"A plugin is a Python file that exists, got {str(path)!r}.")
    # One module per path, so that a file loaded twice is the same plugin.
    module_name = f"eitbench_plugin_{hashlib.sha256(str(file).encode()).hexdigest()[:12]}"
    spec = importlib.util.spec_from_file_location(module_name, file)
    assert spec is not None
    assert spec.loader is not None  # of a Python file
    methods()  # first come, first served: a name that is taken must be taken by now
    module = importlib.util.module_from_spec(spec)
    sys.modules[module_name] = module
    try:
        spec.loader.exec_module(module)
    except InputError:
        raise
    except (Exception, SystemExit) as error:
        hint = ""
        if isinstance(error, ModuleNotFoundError) and (file.parent / f"{error.name}.py").is_file():
            hint = " A plugin is one file: put its modules into it, or make a package of them"
            hint += " (eitbench new-method)."
        raise InputError(
            f"The plugin {file.name} does not run: {type(error).__name__}: {error}.{hint}"
        ) from error
    registered = Plugin(
        METHOD_REGISTRY.of_module(module_name),
        OPERATOR_REGISTRY.of_module(module_name),
        PLACE_REGISTRY.of_module(module_name),
    )
    if not any(registered):
        raise InputError(
            f"The plugin {file.name} registers nothing: decorate a class with "
            '@register("my-name"), @register_place_method("my-name") or '
            '@register_operator("my-name").'
        )
    return registered
