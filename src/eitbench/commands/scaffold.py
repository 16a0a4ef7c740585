"""`eitbench new-method`: an installable package around a method that works already."""

import keyword
import re
from importlib.resources import files
from pathlib import Path
from string import Template

from eitbench.methods.registry import registries
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.storage.files import writing

NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")
MAX_NAME = 50


def new_method(name: str, folder: Path | None = None, *, learned: bool = False) -> list[Path]:
    """Write a package for the method `name` into `folder` (./eitbench-NAME) and list its files.

    Args:
        learned: the method is a network with a training, not a formula.

    Raises:
        InputError: a name that cannot be a method and a package, or is taken; a folder in use.
        EitbenchError: the folder cannot be written.
    """
    _check_name(name)
    folder = Path(f"eitbench-{name}") if folder is None else folder
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(
            f"{folder} exists and is not an empty folder: give another, nothing is written."
        )
    module = "eitbench_" + name.replace("-", "_")
    # MyMethod of my-method, LandweberMethod of landweber.
    words = name.removesuffix("-method").split("-")
    class_name = "".join(word.capitalize() for word in words) + "Method"
    values = {
        "name": name,
        "module": module,
        "class_name": class_name,
        "train": f"python {module}.py\n" if learned else "",
        "tune": "" if learned else f"eitbench tune quick --methods {name}\n",
    }
    templates = files("eitbench.commands") / "templates"
    written = []
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        for template, target in (
            ("pyproject.toml.tmpl", "pyproject.toml"),
            ("README.md.tmpl", "README.md"),
            ("learned.py.tmpl" if learned else "module.py.tmpl", f"{module}.py"),
            ("test_module.py.tmpl", f"test_{module}.py"),
        ):
            text = (templates / template).read_text(encoding="utf-8")
            path = folder / target
            path.write_text(Template(text).substitute(values), encoding="utf-8")
            written.append(path)
    return written


def _check_name(name: str) -> None:
    if not NAME.fullmatch(name) or len(name) > MAX_NAME or keyword.iskeyword(name):
        raise InputError(
            f"{name!r} cannot name a new method: use small letters, digits and hyphens, beginning "
            f"with a letter, at most {MAX_NAME} characters, as in 'my-method'."
        )
    for registry in registries():
        if name in registry.known():
            raise InputError(f"The name {name!r} is taken ({registry.kind}): choose another.")
