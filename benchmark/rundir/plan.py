"""The plan of a run: a suite, and the methods, scenarios and samples chosen of it."""

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from eitbench.benchmark.rundir.kinds import RUN_KINDS, RunKind
from eitbench.benchmark.rundir.manifest import Manifest
from eitbench.benchmark.workers.worker import plugin_names
from eitbench.methods.registry import METHOD_REGISTRY, OPERATOR_REGISTRY
from eitbench.scenarios.errors import InputError, unknown_name
from eitbench.scenarios.suites.suite import Suite

TRACKS = ("default", "tuned", "oracle")
"""As its author set it; with the parameters chosen on validation data; with the best on test."""


@dataclass(frozen=True)
class Plan:
    """All that a run consists of, enough to continue it later.

    Attributes:
        names: the methods or operators, in the order they are run.
        scenarios: names in the order they are run.
        limit: number of test samples of each scenario, None for all.
        plugins: files with more methods or operators, each with the SHA-256 of its content.
        origins: the plugin of each of the names that one registers.
        tracks: those that are run beside the one that is ranked.
    """

    suite: Suite
    names: tuple[str, ...]
    scenarios: tuple[str, ...]
    limit: int | None
    plugins: tuple[tuple[Path, str], ...]
    origins: Mapping[str, Path] = field(default_factory=dict)
    tracks: tuple[str, ...] = ()

    @property
    def kind(self) -> RunKind:
        """The kind of run: of methods or of operators."""
        return RUN_KINDS[self.suite.ranks]

    @property
    def methods(self) -> tuple[str, ...]:
        """The names, if the suite ranks methods.

        Raises:
            InputError: the suite ranks operators.
        """
        if self.suite.ranks != "methods":
            raise InputError(
                f"Suite {self.suite.name!r} ranks operators: name one of methods "
                "(eitbench list suites)."
            )
        return self.names

    def describe(self) -> Manifest:
        """Return plain values for the manifest."""
        return {
            "suite": self.suite.model_dump(mode="json"),
            "names": list(self.names),
            "scenarios": list(self.scenarios),
            "limit": self.limit,
            "tracks": list(self.tracks),
            "plugins": [
                {
                    "path": str(path),
                    "sha256": digest,
                    "names": [name for name, origin in self.origins.items() if origin == path],
                }
                for path, digest in self.plugins
            ],
        }

    @classmethod
    def of(cls, manifest: Manifest, run: Path) -> "Plan":
        """Read the plan that `manifest` of the directory `run` describes.

        Raises:
            InputError: the manifest is incomplete, or a plugin has changed since.
        """
        try:
            plan = manifest["plan"]
            made = cls(
                Suite.model_validate(plan["suite"]),
                tuple(plan["names"]),
                tuple(plan["scenarios"]),
                plan["limit"],
                tuple((Path(p["path"]), p["sha256"]) for p in plan["plugins"]),
                {name: Path(p["path"]) for p in plan["plugins"] for name in p["names"]},
                tuple(plan["tracks"]),
            )
        except (KeyError, TypeError, ValueError) as error:
            reason = " ".join(str(error).split())
            raise InputError(
                f"{run} cannot be resumed: its manifest is incomplete ({reason}). Start a new run."
            ) from error
        for path, digest in made.plugins:
            if not path.is_file() or _sha256(path) != digest:
                raise InputError(
                    f"{run} cannot be resumed: the plugin {path} has changed. Start a new run."
                )
        return made


def make_plan(
    suite: Suite,
    *,
    methods: Sequence[str] = (),
    operators: Sequence[str] = (),
    scenarios: Sequence[str] = (),
    limit: int | None = None,
    plugins: Iterable[Path] = (),
    tracks: Sequence[str] = (),
) -> Plan:
    """Choose from `suite`; without `methods` or `operators`, its own and those of the plugins.

    Raises:
        InputError: an unknown name (the nearest is suggested), methods for a suite that ranks
            operators or the other way round, or a bad plugin.
    """
    ranks = suite.ranks
    for track in tracks:
        if track not in TRACKS:
            raise unknown_name("track", track, TRACKS)
    if tracks and ranks != "methods":
        raise InputError(f"Suite {suite.name!r} ranks operators, which have no tracks.")
    asked, other = (methods, operators) if ranks == "methods" else (operators, methods)
    if other:
        raise InputError(f"Suite {suite.name!r} ranks {ranks}: choose among them with --{ranks}.")
    # Looked up before plugins start workers, which are forked with what is loaded by then.
    known = {*(METHOD_REGISTRY if ranks == "methods" else OPERATOR_REGISTRY).known()}
    files = tuple(dict.fromkeys(path.resolve() for path in plugins))
    origins: dict[str, Path] = {}
    for path in files:
        registered = plugin_names(path)
        offered = registered.methods if ranks == "methods" else registered.operators
        if not offered:
            raise InputError(f"The plugin {path} registers no {ranks}, which {suite.name!r} ranks.")
        for name in offered:
            if name in origins:
                raise InputError(
                    f"The {RUN_KINDS[ranks].name} name {name!r} is registered by {origins[name]} "
                    f"and by {path}: choose another in one of them."
                )
            origins[name] = path
    known |= set(origins)
    chosen = tuple(dict.fromkeys(asked or (*suite.names, *origins)))
    for name in chosen:
        if name not in known:
            raise unknown_name(RUN_KINDS[ranks].name, name, known)
    declared = [scenario.name for scenario in suite.scenarios]
    for name in scenarios:
        if name not in declared:
            raise unknown_name(f"scenario in suite {suite.name!r}:", name, declared)
    return Plan(
        suite,
        chosen,
        tuple(name for name in declared if not scenarios or name in scenarios),
        suite.limit if limit is None else limit,
        tuple((path, _sha256(path)) for path in files),
        origins,
        tuple(dict.fromkeys(tracks)),
    )


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
