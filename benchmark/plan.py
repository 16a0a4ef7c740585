"""What a run consists of: a suite, and what of it was chosen."""

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from eitbench.benchmark.manifest import Manifest
from eitbench.benchmark.worker import plugin_methods
from eitbench.methods.registry import methods as known_methods
from eitbench.scenarios.errors import InputError, unknown_name
from eitbench.scenarios.suites import Suite


@dataclass(frozen=True)
class Plan:
    """What is run: enough to continue it later.

    Attributes:
        methods, scenarios: names in the order they are run.
        limit: number of test samples of each scenario, None for all.
        plugins: files with more methods, each with the SHA-256 of its content.
        origins: the plugin of each method that one registers.
    """

    suite: Suite
    methods: tuple[str, ...]
    scenarios: tuple[str, ...]
    limit: int | None
    plugins: tuple[tuple[Path, str], ...]
    origins: Mapping[str, Path] = field(default_factory=dict)

    def describe(self) -> Manifest:
        """Plain values for the manifest."""
        return {
            "suite": self.suite.model_dump(mode="json"),
            "methods": list(self.methods),
            "scenarios": list(self.scenarios),
            "limit": self.limit,
            "plugins": [
                {
                    "path": str(path),
                    "sha256": digest,
                    "methods": [name for name, origin in self.origins.items() if origin == path],
                }
                for path, digest in self.plugins
            ],
        }

    @classmethod
    def of(cls, manifest: Manifest, run: Path) -> "Plan":
        """The plan that `manifest` of the directory `run` describes.

        Raises:
            InputError: the manifest is incomplete, or a plugin has changed since.
        """
        try:
            plan = manifest["plan"]
            made = cls(
                Suite.model_validate(plan["suite"]),
                tuple(plan["methods"]),
                tuple(plan["scenarios"]),
                plan["limit"],
                tuple((Path(p["path"]), p["sha256"]) for p in plan["plugins"]),
                {name: Path(p["path"]) for p in plan["plugins"] for name in p["methods"]},
            )
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(
                f"{run} cannot be resumed: its manifest is incomplete ({error}). Start a new run."
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
    scenarios: Sequence[str] = (),
    limit: int | None = None,
    plugins: Iterable[Path] = (),
) -> Plan:
    """Choose from `suite`; without `methods`, its default methods and those of the plugins.

    Raises:
        InputError: an unknown method or scenario (the nearest is suggested), or a bad plugin.
    """
    files = tuple(dict.fromkeys(path.resolve() for path in plugins))
    origins: dict[str, Path] = {}
    for path in files:
        for name in plugin_methods(path):
            if name in origins:
                raise InputError(
                    f"The method name {name!r} is registered by {origins[name]} and by {path}: "
                    "choose another in one of them."
                )
            origins[name] = path
    known = {*known_methods(), *origins}
    chosen = tuple(dict.fromkeys(methods or (*suite.methods, *origins)))
    for name in chosen:
        if name not in known:
            raise unknown_name("method", name, known)
    offered = [scenario.name for scenario in suite.scenarios]
    for name in scenarios:
        if name not in offered:
            raise unknown_name(f"scenario of suite {suite.name!r}", name, offered)
    return Plan(
        suite,
        chosen,
        tuple(name for name in offered if not scenarios or name in scenarios),
        suite.limit if limit is None else limit,
        tuple((path, _sha256(path)) for path in files),
        origins,
    )


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
