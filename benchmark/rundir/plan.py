"""The plan of a run: a suite, and the methods, scenarios and samples chosen of it."""

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from eitbench.benchmark.rundir.folder import read_json_file
from eitbench.benchmark.rundir.kinds import RUN_KINDS, RunKind
from eitbench.benchmark.rundir.manifest import Manifest, check_own, first_problem, read
from eitbench.benchmark.workers.worker import plugin_names
from eitbench.methods.places.by_image import create_place_method
from eitbench.methods.registry import (
    METHOD_REGISTRY,
    OPERATOR_REGISTRY,
    place_methods,
    source_hash,
)
from eitbench.scenarios.errors import InputError, unknown_name
from eitbench.scenarios.storage.files import sha256_of
from eitbench.scenarios.storage.limits import check_regular
from eitbench.scenarios.suites.suite import Suite

TRACKS = ("default", "tuned", "oracle")
"""As its author set it; with the parameters chosen on validation data; with the best on test."""

_KNOWN: dict[str, Callable[[], Mapping[str, Any]]] = {
    "methods": METHOD_REGISTRY.known,
    "places": place_methods,
    "operators": OPERATOR_REGISTRY.known,
}
_PARAMETERS = TypeAdapter(dict[str, dict[str, Any]])


class _Declared(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


def plugin_copy(sha256: str) -> str:
    """The place of the copy of a plugin in a run directory."""
    return f"plugins/{sha256[:16]}.py"


class PluginFile(_Declared):
    """A file with more methods or operators, the SHA-256 of its content, and their names.

    Attributes:
        sources: the publication that each of `names` follows.
    """

    path: Path
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
    names: tuple[str, ...]
    sources: tuple[str, ...]

    @property
    def kept(self) -> Path:
        """The place of its copy in a run directory."""
        return Path(plugin_copy(self.sha256))


class Plan(_Declared):
    """All that a run consists of, enough to continue it later; a part of its manifest.

    Attributes:
        names: the methods or operators, in the order they are run.
        scenarios: names in the order they are run.
        limit: number of test samples of each scenario, None for all.
        tracks: those that are run beside the one that is ranked.
        parameters: constructor parameters that were given, by method; instead of selected ones.
        installed: of the names that an installed package registers, the SHA-256 of its file.
    """

    suite: Suite
    names: tuple[str, ...]
    scenarios: tuple[str, ...]
    limit: int | None
    tracks: tuple[str, ...]
    plugins: tuple[PluginFile, ...]
    parameters: dict[str, dict[str, Any]] = {}
    installed: dict[str, str] = {}

    @property
    def kind(self) -> RunKind:
        """The kind of run: of methods that make images or say places, or of operators."""
        return RUN_KINDS[self.suite.ranks]

    @property
    def methods(self) -> tuple[str, ...]:
        """The names, if the suite ranks methods that make images.

        Raises:
            InputError: the suite ranks something else.
        """
        if self.suite.ranks != "methods":
            raise InputError(
                f"Suite {self.suite.name!r} ranks {self.suite.ranks}: name a suite that ranks "
                "methods that make images (eitbench list suites)."
            )
        return self.names

    @property
    def origins(self) -> dict[str, PluginFile]:
        """The plugin of each of the names that one registers."""
        return {name: plugin for plugin in self.plugins for name in plugin.names}

    def code(self, name: str) -> str:
        """SHA-256 (hex) of the file that a method of somebody else is in; "" for one of ours."""
        if name in self.origins:
            return self.origins[name].sha256
        return self.installed.get(name, "")

    def source(self, name: str) -> str:
        """The publication that a method or operator follows; "" if it names none."""
        if name in self.origins:
            plugin = self.origins[name]
            return dict(zip(plugin.names, plugin.sources, strict=False)).get(name, "")
        return str(_KNOWN[self.suite.ranks]()[name].source)


class _Cell(BaseModel):
    scenario: str
    name: str
    variant: str
    track: str
    parameters: dict[str, Any]
    spent: dict[str, Any]


class _Planned(BaseModel):
    plan: Plan


class _Resumable(_Planned):
    """What a run is continued from, besides what every manifest has."""

    batch: int
    resumed: list[Any]
    refused: dict[str, Any]
    cells: list[_Cell]


def plan_of(manifest: Manifest, run: Path, needed: type[_Planned] = _Planned) -> Plan:
    """Return the plan that `manifest` of the directory `run` describes.

    Raises:
        InputError: something that is needed is missing.
    """
    try:
        return needed.model_validate(manifest).plan
    except ValidationError as error:
        raise InputError(
            f"{run} cannot be resumed: its manifest is incomplete ({first_problem(error)[0]!r}). "
            "Start a new run."
        ) from error


def read_resumable(run: Path) -> tuple[Manifest, Plan]:
    """Read the manifest and the plan of a run that is to be continued.

    Raises:
        InputError, DataCorruptError: as for `plan_of` and `manifest.read`, or a plugin has changed.
    """
    manifest = read(run)
    check_own(run, manifest, "start a run of your own")
    plan = plan_of(manifest, run, _Resumable)
    for plugin in plan.plugins:
        if not plugin.path.is_file():
            raise InputError(
                f"{run} cannot be resumed: the plugin {plugin.path} is not there. Put it back; "
                f"{run / plugin.kept} is a copy."
            )
        if sha256_of(plugin.path) != plugin.sha256:
            raise InputError(
                f"{run} cannot be resumed: the plugin {plugin.path} has changed. Start a new run."
            )
    now = _installed(plan.suite.ranks, plan.installed)
    for name in plan.installed:
        if now.get(name) != plan.installed[name]:
            raise InputError(
                f"{run} cannot be resumed: the file of the installed method {name!r} has changed "
                "since it was started, or is gone. Start a new run."
            )
    return manifest, plan


def make_plan(
    suite: Suite,
    *,
    methods: Sequence[str] = (),
    operators: Sequence[str] = (),
    scenarios: Sequence[str] = (),
    limit: int | None = None,
    plugins: Iterable[Path] = (),
    tracks: Sequence[str] = (),
    parameters: Mapping[str, Mapping[str, Any]] | None = None,
    isolate: bool = False,
) -> Plan:
    """Choose from `suite`; without `methods` or `operators`, its own and those of the plugins.

    Args:
        parameters: constructor parameters by method, instead of selected ones.
        isolate: load the plugins where they can neither use the network nor read other files.

    Raises:
        InputError: an unknown name (the nearest is suggested), methods for a suite that ranks
            operators or the other way round, or a bad plugin.
    """
    ranks = suite.ranks
    for track in tracks:
        if track not in TRACKS:
            raise unknown_name("track", track, TRACKS)
    if tracks and ranks != "methods":
        raise InputError(f"Suite {suite.name!r} ranks {ranks}, which have no tracks.")
    asked, other = (operators, methods) if ranks == "operators" else (methods, operators)
    if other:
        option = "operators" if ranks == "operators" else "methods"
        raise InputError(f"Suite {suite.name!r} ranks {ranks}: choose among them with --{option}.")
    # Looked up before plugins start workers, which are forked with what is loaded by then.
    known = {*_KNOWN[ranks]()}
    given = {name: dict(values) for name, values in (parameters or {}).items()}
    if given and ranks == "operators":
        raise InputError(f"Suite {suite.name!r} ranks operators, which take no parameters.")
    files: list[PluginFile] = []
    for path in dict.fromkeys(path.resolve() for path in plugins):
        registered = plugin_names(path, parameters=given, isolate=isolate)
        offered = {
            "methods": registered.methods,
            "places": registered.methods | registered.places,
            "operators": registered.operators,
        }[ranks]
        if not offered:
            raise InputError(f"The plugin {path} registers no {ranks}, which {suite.name!r} ranks.")
        for other_file in files:
            if both := set(offered) & set(other_file.names):
                raise InputError(
                    f"The {RUN_KINDS[ranks].name} name {min(both)!r} is registered by "
                    f"{other_file.path} and by {path}: choose another in one of them."
                )
        sources = tuple(map("\n".join, offered.values()))
        files.append(
            PluginFile(path=path, sha256=sha256_of(path), names=tuple(offered), sources=sources)
        )
    own = [name for file in files for name in file.names]
    known |= set(own)
    chosen = tuple(dict.fromkeys(asked or (*suite.names, *own)))
    for name in chosen:
        if ranks == "methods" and name not in known and name in place_methods():
            raise InputError(
                f"{name!r} says places and makes no images, which suite {suite.name!r} ranks: run "
                "it on a suite such as new-skin."
            )
        if name not in known:
            raise unknown_name(RUN_KINDS[ranks].name, name, known)
    for name, values in given.items():
        if name not in chosen:
            raise unknown_name("method in the parameters:", name, chosen)
        if name not in own:  # those of plugins were made when these were loaded
            if "weights" in values:
                raise InputError(
                    f"A run takes the weights of {name!r} that are installed for the sensor, and "
                    "records their hash: leave `weights` out of its parameters."
                )
            create_place_method(name, **values)
    declared = [scenario.name for scenario in suite.scenarios]
    for name in scenarios:
        if name not in declared:
            raise unknown_name(f"scenario in suite {suite.name!r}:", name, declared)
    # Frames that may be novel are told from those of the familiar scenario.
    wanted = {
        name
        for scenario in suite.scenarios
        if not scenarios or scenario.name in scenarios
        for name in (scenario.name, suite.familiar(scenario).name)
    }
    return Plan(
        suite=suite,
        names=chosen,
        scenarios=tuple(name for name in declared if name in wanted),
        limit=suite.limit if limit is None else limit,
        tracks=tuple(dict.fromkeys(tracks)),
        plugins=tuple(files),
        parameters=given,
        installed=_installed(ranks, [name for name in chosen if name not in own]),
    )


def _installed(ranks: str, names: Iterable[str]) -> dict[str, str]:
    """SHA-256 of the file of each of `names` that another installed package registers."""
    known = _KNOWN[ranks]()
    files = {name: source_hash(known[name]) for name in names if name in known}
    return {name: sha256 for name, sha256 in files.items() if sha256}


def read_parameters(text: str) -> dict[str, dict[str, Any]]:
    """Return constructor parameters by method from JSON, or from the path of a file of JSON.

    Raises:
        InputError: it is not JSON of this form, or names something twice.
    """
    try:
        content = text.encode() if text.lstrip().startswith("{") else _small_file(Path(text))
        found: dict[str, dict[str, Any]] = _PARAMETERS.validate_python(
            json.loads(
                content,
                object_pairs_hook=_without_repeats,
                parse_constant=_no_constant,
                parse_float=_finite,
            )
        )
    except InputError:
        raise
    except (OSError, ValueError, RecursionError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not JSON of this form"
        raise InputError(
            f'Parameters are JSON by method, such as {{"noser": {{"weight": 0.1}}}}, or the '
            f"path of a file that holds it; got {text[:80]!r}: {reason}."
        ) from error
    return found


def _no_constant(name: str) -> float:
    raise ValueError(f"{name} is no JSON")


def _finite(text: str) -> float:
    if math.isinf(value := float(text)):
        raise ValueError(f"{text} is too large")
    return value


def _without_repeats(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    names = [name for name, _ in pairs]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"The parameters name {name!r} more than once: give it one value.")
    return dict(pairs)


def _small_file(path: Path) -> bytes:
    check_regular(path)
    return read_json_file(path)
